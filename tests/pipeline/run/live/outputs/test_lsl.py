"""Streams of LSL, read by its own inlets on this machine."""

import contextlib
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyxdf

from pipeline.core.joints import JointSet
from pipeline.motion.angles.compute import observable_angles, segment_angles
from pipeline.motion.body_segments import ANGLE_NAMES, SEGMENTS, angles_rad
from pipeline.motion.skeleton.model import INDEX
from pipeline.run.live.outputs.addresses import OutputAddress
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.records import LiveInstant, LivePerson
from tests.pipeline.run.live.outputs.people import (
    JOINTS,
    TOLERANCE_DEG,
    TOLERANCE_M,
    live_instant,
    skeleton_of,
    world_matrices,
)
from tests.pipeline.run.live.outputs.xdf import RecordedStream, write_xdf

pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed (the extra `lsl`)")
from pipeline.run.live.outputs.lsl import LslOutput, pose_angles_deg  # noqa: E402 - it needs pylsl

RATE_HZ = 50.0
ANGLES = observable_angles(JointSet(JOINTS, ()))


@contextlib.contextmanager
def sending(num_people: int = 1) -> Iterator[tuple[LslOutput, str]]:
    """Output, and the name of its streams."""
    name = f"multicap-{uuid.uuid4().hex}"
    address = OutputAddress("lsl", name, 0, {"people": str(num_people)}, is_network=True)
    with LslOutput(OutputStart(address, RATE_HZ, JOINTS)) as output:
        yield output, name


def opened(output: LslOutput, *names: str) -> list[Any]:
    """Inlets of streams that get samples: instants without people are sent until they come."""
    inlets = []
    for name in names:
        (info,) = pylsl.resolve_byprop("name", name, timeout=60)
        inlets.append(pylsl.StreamInlet(info))
    waiting = list(inlets)
    for step in range(3000):
        output.send(LiveInstant(step / RATE_HZ, (), 0.0))
        waiting = [inlet for inlet in waiting if inlet.pull_sample(0.02)[0] is None]
        if not waiting:
            break
    assert not waiting
    for inlet in inlets:
        while inlet.pull_sample(0.1)[0] is not None:
            pass
    return inlets


def pulled(inlet: Any, num_samples: int) -> tuple[list[list[Any]], list[float]]:
    samples = [inlet.pull_sample(60) for _ in range(num_samples)]
    assert all(sample is not None for sample, _ in samples)
    return [sample for sample, _ in samples], [stamp for _, stamp in samples]


def same_turn_deg(angles: dict[str, float], expected: dict[str, float]) -> float:
    """Largest difference of angles, a full turn being none."""
    return max(abs((angles[name] - expected[name] + 180) % 360 - 180) for name in angles)


def test_inlets_get_joints_and_angles_of_four_people() -> None:
    instant = live_instant(time_s=1000.0)
    with sending(4) as (output, name):
        names = [f"{name}-{slot}-{stream}" for slot in (1, 2, 3, 4) for stream in ("joints", "angles")]
        inlets = opened(output, *names)
        assert output.send(instant) == 8
        got = [pulled(inlet, 1)[0][0] for inlet in inlets]
    for person, (position_m, angle_deg) in zip(instant.people, zip(got[::2], got[1::2], strict=True), strict=True):
        np.testing.assert_allclose(np.reshape(position_m, (-1, 3)), person.xyz_m, atol=TOLERANCE_M)
        world = world_matrices(skeleton_of(person))
        thigh, shank = (
            world[INDEX[SEGMENTS[name].joint]] @ SEGMENTS[name].rest_from_segment
            for name in ("right_thigh", "right_shank")
        )
        knee_deg = -np.degrees(angles_rad(thigh.T @ shank, (2, 0, 1)))[0]
        assert dict(zip(ANGLES, angle_deg, strict=True))["right_knee_flexion"] == pytest.approx(
            knee_deg, abs=TOLERANCE_DEG
        )


def test_angles_of_small_turns_are_those_of_finished_sessions() -> None:
    """Both take the triple of smaller angles there."""
    skeleton = skeleton_of(live_instant([1]).people[0])
    skeleton.parent_from_joint[:] = skeleton.parent_from_joint * (0.1, 0.1, 0.1, 0.0) + (0.0, 0.0, 0.0, 1.0)
    skeleton.parent_from_joint[:] /= np.linalg.norm(skeleton.parent_from_joint, axis=-1, keepdims=True)
    world = world_matrices(skeleton)
    segments = {name: (world[INDEX[s.joint]] @ s.rest_from_segment)[None] for name, s in SEGMENTS.items()}
    expected_deg = dict(zip(ANGLE_NAMES, np.degrees(segment_angles(segments)[0]), strict=True))
    got_deg = dict(zip(ANGLE_NAMES, pose_angles_deg([skeleton])[0], strict=True))
    assert len(got_deg) == 43
    assert same_turn_deg({k: v for k, v in got_deg.items() if "shoulder" not in k}, expected_deg) < 1e-6


def test_metadata_name_channels_with_units() -> None:
    with sending() as (output, name):
        joints, quality = opened(output, f"{name}-1-joints", f"{name}-1-quality")
        info, markers = joints.info(60), quality.info(60)
    assert (info.type(), info.nominal_srate(), info.channel_count()) == ("MoCap", RATE_HZ, 3 * len(JOINTS))
    assert info.source_id() == f"multicap-{name}-1-joints"
    channel = info.desc().child("channels").child("channel")
    fields = [channel.child_value(field) for field in ("label", "marker", "type", "unit")]
    assert fields == ["nose_X", "nose", "PositionX", "meters"]
    assert (markers.type(), markers.nominal_srate()) == ("Markers", pylsl.IRREGULAR_RATE)


def test_stamps_keep_distances_of_instants_on_lsl_clock() -> None:
    """Delays of sending move no stamp later than the earliest sample tells."""
    instants = [live_instant([1], 1000.0 + step / RATE_HZ) for step in range(10)]
    with sending() as (output, name):
        (inlet,) = opened(output, f"{name}-1-joints")
        start_s = pylsl.local_clock()
        for step, instant in enumerate(instants):
            time.sleep(0.02 + 0.03 * (step % 3))
            output.send(LiveInstant(instant.time_s, instant.people, 0.1))
        end_s = pylsl.local_clock()
        _, stamps_s = pulled(inlet, len(instants))
    np.testing.assert_allclose(np.diff(stamps_s), 1 / RATE_HZ, atol=1e-3)
    assert start_s - 0.1 < stamps_s[0] < stamps_s[-1] < end_s


def test_quality_tells_who_comes_and_goes() -> None:
    first = live_instant([3]).people[0]
    located = LivePerson(3, first.xyz_m, None)
    with sending() as (output, name):
        inlet, joints = opened(output, f"{name}-1-quality", f"{name}-1-joints")
        for step, people in enumerate([(located,), (located,), (first,), ()]):
            output.send(LiveInstant(1000.0 + step / RATE_HZ, people, 0.0))
        markers, _ = pulled(inlet, 3)
        positions_m, _ = pulled(joints, 4)
    assert [marker for (marker,) in markers] == ["person-3 located", "person-3 tracked", "absent"]
    assert np.isfinite(positions_m[:3]).all()
    assert np.isnan(positions_m[3]).all()


def test_recording_has_labels_units_and_common_times(tmp_path: Path) -> None:
    instants = [live_instant([1], 1000.0 + step / RATE_HZ, seed=step) for step in range(5)]
    with sending() as (output, name):
        inlets = opened(output, *(f"{name}-1-{stream}" for stream in ("joints", "angles", "quality")))
        for instant in instants:
            output.send(instant)
        streams = [
            RecordedStream(inlet.info(60).as_xml(), *pulled(inlet, num_samples))
            for inlet, num_samples in zip(inlets, (5, 5, 1), strict=True)
        ]
    write_xdf(tmp_path / "take.xdf", streams)
    joints, angles, quality = pyxdf.load_xdf(tmp_path / "take.xdf", dejitter_timestamps=False)[0]
    channels = joints["info"]["desc"][0]["channels"][0]["channel"]
    assert [channel["label"][0] for channel in channels[:3]] == ["nose_X", "nose_Y", "nose_Z"]
    assert {channel["unit"][0] for channel in channels} == {"meters"}
    expected_m = [instant.people[0].xyz_m.ravel() for instant in instants]
    np.testing.assert_allclose(joints["time_series"], expected_m, atol=TOLERANCE_M)
    np.testing.assert_allclose(angles["time_stamps"], joints["time_stamps"])
    named = [channel["label"][0] for channel in angles["info"]["desc"][0]["channels"][0]["channel"]]
    assert tuple(named) == ANGLES
    assert quality["time_series"] == [["person-1 tracked"]]
    assert quality["time_stamps"][0] == joints["time_stamps"][0]
