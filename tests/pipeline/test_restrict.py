"""Reconstruction of some of a session's frames, and of some of its people."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.errors import InputError
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> KeypointSession:
    """Session of three people and four unsynchronised cameras over 3 s."""
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("unsynchronised"), duration_s=3.0), seed=4), folder)
    return open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")


def positions(found: Reconstruction) -> Mapping[int, np.ndarray]:
    """World positions (frames of the session, joints, 3) of each person, NaN where absent."""
    whole = {}
    for track in found.located:
        xyz_m = np.full((found.timebase.num_frames, *track.xyz_m.shape[1:]), np.nan)
        xyz_m[track.start_frame : track.start_frame + track.num_frames] = track.xyz_m
        whole[track.track_id] = xyz_m
    return whole


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_they_move_as_they_do_in_whole(session: KeypointSession, method: Method) -> None:
    config = ReconstructionConfig(method=method, smoothing="none")
    whole = positions(reconstruct(session, config))
    part = reconstruct(session, replace(config, frame_range=(30, 70)))
    assert part.timebase.num_frames == 40
    assert part.timebase.start_time_s == pytest.approx(session.timebase.time_s(30))
    assert len(part.located) == len(whole) == 3
    for mine in positions(part).values():
        distances_m = [np.nanmedian(np.linalg.norm(theirs[30:70] - mine, axis=-1)) for theirs in whole.values()]
        assert min(distances_m) < 0.005


@pytest.mark.slow
def test_all_of_them_are_whole(session: KeypointSession) -> None:
    frames = 0, session.timebase.num_frames
    whole, same = (reconstruct(session, ReconstructionConfig(frame_range=one)) for one in (None, frames))
    for one, other in zip(whole.located, same.located, strict=True):
        np.testing.assert_array_equal(one.xyz_m, other.xyz_m)


@pytest.mark.parametrize("frames", [range(-1, 10), range(5, 5), range(9, 5), range(10_000)])
def test_frames_that_are_not_there(session: KeypointSession, frames: range) -> None:
    with pytest.raises(InputError, match="output frames 0 to") as error:
        session.restricted(frames)
    assert [problem.code for problem in error.value.problems] == ["frame_range"]


@pytest.mark.parametrize("method", ["tracking", pytest.param("clustering", marks=pytest.mark.slow)])
def test_those_whom_most_cameras_saw_for_longest_stay(
    session: KeypointSession, task_cache: Path, method: Method
) -> None:
    config = ReconstructionConfig(method=method, smoothing="none")
    everybody = reconstruct(session, config, cache=task_cache).located
    seen = sorted((int(track.views.sum()) for track in everybody), reverse=True)
    for most in (1, 2, 3, 9):
        some = reconstruct(session, replace(config, people=most), cache=task_cache)
        assert [track.track_id for track in some.located] == list(range(1, min(most, 3) + 1))
        assert sorted((int(track.views.sum()) for track in some.located), reverse=True) == seen[:most]
        assert len(some.animation.motions) == len(some.located)
