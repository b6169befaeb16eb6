"""Declared offsets with stated uncertainties: clocks within them, beyond them, and without any motion."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.synchronization.session_clocks import on_measured_clocks, synchronize_declared
from pipeline.capture.synchronization.sound_offsets import SoundOffsets
from pipeline.core.data.cameras import FrameTimes, Synchronization
from pipeline.core.errors import InputError
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.core.runtime.record_archive import decode, encode
from pipeline.run.engine.local import reconstruct, session_facts
from pipeline.run.engine.plan import STAGE_BY_NAME, STAGES, plan
from pipeline.run.engine.stage import ASSOCIATE, DETECT, SYNCHRONIZE
from pipeline.validation.simulation.motion.script import Gesture
from pipeline.video.timeline import session_timebase
from tests.pipeline.capture.synchronization.conftest import Take, alone, cut_take, shortened

CUT = (0, 12, 20)


def measured(take: Take, errors_s: Sequence[float], stds_s: Sequence[float | None]) -> Synchronization:
    """Clocks of a take whose starts are declared with errors."""
    names = [camera.name for camera in take.cameras]
    starts_s = {name: true_s + error_s for name, true_s, error_s in zip(names, take.start_s, errors_s, strict=True)}
    times = {name: FrameTimes(take.times[name].time_s + starts_s[name]) for name in names}
    known = {name: std_s for name, std_s in zip(names, stds_s, strict=True) if std_s is not None}
    return synchronize_declared(take.cameras, times, take.detections, take.joints, starts_s, SoundOffsets(), known)


def errors_s(take: Take, found: Synchronization) -> list[float]:
    """Errors of the measured offsets, relative to the first camera."""
    offsets_s = np.array([clock.offset_s for clock in found.clocks]) - np.array(take.start_s)
    return [float(value) for value in offsets_s - offsets_s[0]]


def test_motion_refines_offsets_within_uncertainty() -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, 0.03, -0.02), (0.01, 0.01, 0.01))
    assert found.is_certain
    assert not found.warnings
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)


def test_repeated_motion_is_decided_by_declared_offsets() -> None:
    take = cut_take(alone(Gesture.JUMP, 8.0), 4, CUT)
    assert "sync_ambiguous" in {problem.code for problem in take.synchronized().refusals}
    found = measured(take, (0.0, 0.02, 0.0), (0.01, 0.01, 0.01))
    assert found.is_certain
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.02)


@pytest.mark.parametrize("error_s", [0.3, 1.4])
def test_offset_beyond_uncertainty_is_used_with_warning(error_s: float) -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, error_s, 0.0), (0.005, 0.005, 0.005))
    assert found.is_certain
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)
    (warning,) = [warning for warning in found.warnings if warning.code == "sync_beyond_declared"]
    assert warning.camera == take.cameras[1].name
    said_s = float(warning.message.partition(" s earlier")[0].rpartition(" ")[2])
    assert said_s == pytest.approx(error_s, abs=0.005)


def test_clocks_are_as_declared_where_nobody_moves() -> None:
    take = cut_take(alone(Gesture.IDLE, 4.0), 4, CUT)
    found = measured(take, (0.0, 0.001, 0.0), (0.002, 0.003, 0.004))
    assert found.is_certain
    assert [warning.code for warning in found.warnings] == ["sync_as_declared"]
    assert errors_s(take, found) == pytest.approx([0.0, 0.001, 0.0], abs=1e-9)
    assert [clock.sigma_s for clock in found.clocks] == [0.002, 0.003, 0.004]
    rough = measured(take, (0.0, 0.001, 0.0), (0.002, 0.1, 0.004))
    assert rough.refusals
    partly = measured(take, (0.0, 0.001, 0.0), (0.002, None, 0.004))
    assert partly.refusals


def test_without_uncertainties_nothing_changes() -> None:
    take = cut_take(shortened("room", 5.0), 4, CUT)
    found = measured(take, (0.0, 0.3, 0.0), (None, None, 0.01))
    assert found.is_certain
    assert not found.warnings
    assert errors_s(take, found) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)


CODES = dict.fromkeys(STAGE_BY_NAME, "")


def session_of(take: Take) -> KeypointSession:
    """Session of keypoints with each camera's own times."""
    timebase = session_timebase(take.times)
    folders = {name: name for name in take.times}
    return KeypointSession(take.cameras, take.times, timebase, take.detections, take.joints, folders, ())


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_motion_is_that_of_synchronised_cameras(method: Method, tmp_path: Path) -> None:
    scene = shortened("room", 5.0)
    whole = session_of(cut_take(scene, 4, (0, 0, 0, 0)))
    cut = session_of(cut_take(scene, 4, (0, 15, 25, 5)))
    config = ReconstructionConfig(method, smoothing="none", chunk_frames=40, sync="auto")
    found = reconstruct(cut, config, cache=tmp_path)
    assert found.synchronization is not None
    assert [clock.offset_s for clock in found.synchronization.clocks] == pytest.approx([0.0, 0.6, 1.0, 0.2], abs=0.01)
    truth = reconstruct(whole, replace(config, sync="declared"))
    assert found.timebase.num_frames == truth.timebase.num_frames
    assert len(found.tracks) == len(truth.tracks)
    # While all cameras record, the positions are nearly as with synchronised cameras.
    for track in found.tracks:
        rows = np.arange(30, 120)
        positions_m = track.xyz_m[rows - track.start_frame]
        apart_m = [
            np.nanmedian(np.linalg.norm(positions_m - other.xyz_m[rows - other.start_frame], axis=-1))
            for other in truth.tracks
        ]
        assert min(apart_m) < 0.01
    declared = reconstruct(cut, replace(config, sync="declared"))
    assert declared.synchronization is None
    again = reconstruct(cut, replace(config, chunk_frames=1000), cache=tmp_path)
    for one, other in zip(found.tracks, again.tracks, strict=True):
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)


def test_wanted_frames_are_those_of_measured_clock() -> None:
    cut = session_of(cut_take(shortened("room", 5.0), 4, (0, 15, 25)))
    config = ReconstructionConfig(smoothing="none", sync="auto")
    whole, part = (reconstruct(cut, replace(config, frame_range=frames)) for frames in (None, (40, 100)))
    assert part.timebase.num_frames == 60
    assert part.timebase.start_time_s == pytest.approx(whole.timebase.time_s(40))
    assert part.synchronization == whole.synchronization
    nose_m = part.tracks[0].xyz_m[30 - part.tracks[0].start_frame, 0]
    apart_m = [np.linalg.norm(track.xyz_m[70 - track.start_frame, 0] - nose_m) for track in whole.tracks]
    assert min(apart_m) < 0.02


def test_uncertain_clocks_end_reconstruction_with_reason() -> None:
    session = session_of(cut_take(alone(Gesture.IDLE, 4.0), 1, (0, 12, 20)))
    with pytest.raises(InputError) as caught:
        reconstruct(session, ReconstructionConfig(sync="auto"))
    assert {problem.code for problem in caught.value.problems} == {"sync_no_motion"}
    assert all("offset" in (problem.hint or "") for problem in caught.value.problems)


def test_session_is_as_long_as_its_cameras_recorded_together() -> None:
    take = cut_take(shortened("room", 5.0), 4, (0, 25))
    first = take.cameras[0].name
    times = {**take.times, first: replace(take.times[first], time_s=take.times[first].time_s[:110])}
    session = replace(session_of(take), times=times, timebase=session_timebase(times))
    clocks = take.synchronized()
    measured = on_measured_clocks(session, clocks)
    assert session.timebase.num_frames == 110
    assert measured.timebase.num_frames == 125
    assert measured.timebase.start_time_s == session.timebase.start_time_s
    assert decode(Synchronization, encode(clocks)) == clocks


def test_stages_after_synchronisation_depend_on_it() -> None:
    facts = replace(session_facts(session_of(cut_take(shortened("room", 2.0), 4, (0, 0)))), has_videos=True)
    config = ReconstructionConfig(frame_range=(10, 20))
    declared = {stage.name: list(stage.tasks) for stage in plan(facts, config, CODES)}
    auto = {stage.name: list(stage.tasks) for stage in plan(facts, replace(config, sync="auto"), CODES)}
    assert SYNCHRONIZE not in declared
    assert auto[ASSOCIATE][0].key != declared[ASSOCIATE][0].key
    # Cameras that are late took the wanted frames at other times, so all frames are detected.
    assert {task.frames for task in declared[DETECT]} == {range(10, 20)}
    assert {task.frames for task in auto[DETECT]} == {range(facts.num_frames)}
    after = STAGES[[stage.name for stage in STAGES].index(SYNCHRONIZE) + 1 :]
    assert all(SYNCHRONIZE in stage.follows for stage in after)
