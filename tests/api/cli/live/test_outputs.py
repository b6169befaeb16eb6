"""Listeners of live captures: lines of JSON, kept keypoints, the terminal."""

import io
import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from api.cli.live.outputs import JsonLines, KeptKeypoints, ListenerGroup, opened_output, summary_line
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.errors import PipelineError
from pipeline.core.runtime.child_processes import python_command
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import detected_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.simulation.scenes import SCENES, Joints, record
from tests.pipeline.clothes import dress
from tests.small_disk import fill, small_disk

RATE_HZ = 25.0


@pytest.mark.parametrize("joints", ["body", "feet"])
def test_kept_capture_is_session(tmp_path: Path, joints: Joints) -> None:
    simulation = record(replace(SCENES["room"], duration_s=1.0), 0, 3, joints)
    kept = KeptKeypoints(tmp_path / "kept")
    kept.begin(simulation.cameras, simulation.joints, RATE_HZ)
    cameras = simulation.cameras
    dressed = dress(simulation, lambda person, time_s: person)
    for frame in detected_frames(cameras, dressed.times, dressed.detections):
        assert frame.colour is not None
        kept.take(cameras[frame.camera], frame)
    folder = tmp_path / "kept"
    session = open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")
    assert [camera.name for camera in session.cameras] == [camera.name for camera in cameras]
    shared = [name for name in simulation.joints.names if name in session.joints.names]
    assert len(shared) == len(simulation.joints.names)
    for camera in cameras:
        given, found = simulation.detections[camera.name], session.detections[camera.name]
        np.testing.assert_array_equal(found.frame, given.frame)
        assert len(found.colour) == 0  # colours of clothes are kept nowhere
        np.testing.assert_allclose(session.times[camera.name].time_s, simulation.times[camera.name].time_s)
        places = session.joints.indices(simulation.joints.names)
        np.testing.assert_allclose(found.keypoints_px[:, places], given.keypoints_px, atol=1e-9)


def test_output_line_is_instant() -> None:
    simulation, file = record(replace(SCENES["room"], duration_s=0.4), 0, 3), io.StringIO()
    lines = JsonLines(file)
    lines.begin(simulation.cameras, simulation.joints, RATE_HZ)
    lines.tell("cam_00 is lost.")
    capture = LiveCapture(simulation.cameras, simulation.joints, LiveSettings(RATE_HZ))
    for frame in detected_frames(simulation.cameras, simulation.times, simulation.detections):
        for instant in capture.push(*frame):
            lines.show(instant, 0.0123)
    ready, notice, *instants = map(json.loads, file.getvalue().splitlines())
    assert (ready["type"], ready["joints"], ready["frame_rate_hz"]) == ("ready", list(simulation.joints.names), 25.0)
    assert notice == {"type": "notice", "message": "cam_00 is lost."}
    assert [instant["sequence"] for instant in instants] == list(range(10))
    assert {instant["latency_s"] for instant in instants} == {0.0123}
    assert len(instants[-1]["people"]) == 3


def test_disk_full_is_sentence(tmp_path: Path) -> None:
    with pytest.raises(PipelineError, match="No space left"), opened_output(Path("/dev/full")) as full:
        JsonLines(full).tell("x")
    with pytest.raises(PipelineError, match="No such file"), opened_output(tmp_path / "none" / "file.jsonl"):
        pass
    (tmp_path / "kept").touch()
    simulation = record(replace(SCENES["room"], duration_s=0.1), 0, 2)
    with pytest.raises(PipelineError, match="kept can't be written"):
        KeptKeypoints(tmp_path / "kept").begin(simulation.cameras, simulation.joints, RATE_HZ)


def test_terminal_line_has_figures() -> None:
    totals = LiveTotals([CameraTotals("a", decoded=90, detected=60), CameraTotals("b", decoded=110, detected=90)])
    assert summary_line(totals, "nobody") == "0 s, 0.0 Hz, nobody, no instant yet, 25 % of frames dropped"
    totals.duration_s, totals.instants = 4.0, 100
    for number in range(100):
        totals.latencies.add(0.001 * number)
    assert summary_line(totals, "2 people now") == (
        "4 s, 25.0 Hz, 2 people now, latency 49 ms (p95 94 ms), 25 % of frames dropped"
    )


def test_capture_full_disk_leaves_session_and_continues(tmp_path: Path) -> None:
    simulation, lines = record(replace(SCENES["room"], duration_s=8.0), 0, 3), io.StringIO()
    cameras = simulation.cameras
    with small_disk(tmp_path / "disk", 4) as disk:
        outputs = ListenerGroup([KeptKeypoints(disk / "kept"), JsonLines(lines)])
        outputs.begin(cameras, simulation.joints, RATE_HZ)
        frames = detected_frames(cameras, simulation.times, simulation.detections)
        for number, frame in enumerate(frames):
            if number == 200:
                fill(disk / "others")
            outputs.take(cameras[frame.camera], frame)
        outputs.end(LiveTotals([]))
        folder = disk / "kept"
        session = open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")
    num_kept = sum(len(times.time_s) for times in session.times.values())
    assert num_kept == 200 < len(frames)
    assert [str(error) for error in outputs.errors] == ["kept can't be written: No space left on device."]
    _, notice, ended = map(json.loads, lines.getvalue().splitlines())
    assert "No space left on device. The capture continues without it." in notice["message"]
    assert ended["type"] == "ended"


def test_outputs_all_failed_end_capture(tmp_path: Path) -> None:
    with pytest.raises(PipelineError, match="No space left"), opened_output(Path("/dev/full")) as full:
        ListenerGroup([JsonLines(full)]).tell("x")


KEEPING = """
import itertools, sys
from dataclasses import replace
from pathlib import Path
from api.cli.live.outputs import KeptKeypoints
from pipeline.run.live.records import detected_frames
from pipeline.validation.simulation.scenes import SCENES, record
simulation = record(replace(SCENES["room"], duration_s=2.0), 0, 3)
kept = KeptKeypoints(Path(sys.argv[1]))
kept.begin(simulation.cameras, simulation.joints, 25.0)
frames = detected_frames(simulation.cameras, simulation.times, simulation.detections)
for turn in itertools.count():
    for frame in frames:
        kept.take(simulation.cameras[frame.camera], frame._replace(time_s=2.0 * turn + frame.time_s))
        print("kept", flush=True)
"""


@pytest.mark.slow
def test_capture_killed_leaves_session(tmp_path: Path) -> None:
    for attempt in range(3):
        folder = tmp_path / f"kept_{attempt}"
        command = python_command("-c", KEEPING, str(folder))
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[4])}
        with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
            assert process.stdout is not None
            for _ in range(150 + 77 * attempt):
                process.stdout.readline()
            process.kill()
        session = open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")
        assert sum(len(times.time_s) for times in session.times.values()) >= 150
