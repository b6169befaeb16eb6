"""Offsets of cameras' clocks from the people of a capture's first seconds."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.run.live.cameras.offsets import OffsetSearch, find_offsets
from pipeline.run.live.records import DetectedFrame, detected_frames
from pipeline.validation.simulation.scenes import SCENES, Simulation, record

LATE_S = (0.0, 0.12, -0.05)


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=4.0), 1, 3)


@pytest.fixture(scope="module")
def frames(room: Simulation) -> list[DetectedFrame]:
    """Frames whose times are late by ``LATE_S`` of their camera."""
    sent = detected_frames(room.cameras, room.times, room.detections)
    return [frame._replace(time_s=frame.time_s + LATE_S[frame.camera]) for frame in sent]


def test_offsets_make_late_cameras_agree(room: Simulation, frames: list[DetectedFrame]) -> None:
    search = OffsetSearch(room.cameras, room.joints, 3.0)
    with ThreadPoolExecutor(1) as pool:
        assert not search.advance(2.9, pool)
        for frame in frames:
            search.add(frame)
        search.advance(3.0, pool)
    num_searched = len(search.frames)
    search.add(frames[-1])
    assert len(search.frames) == num_searched
    with ThreadPoolExecutor(1) as pool:
        assert search.advance(4.0, pool)
        assert not search.advance(5.0, pool)
    assert search.offsets_s is not None
    np.testing.assert_allclose(np.array(search.offsets_s) - search.offsets_s[0], -np.array(LATE_S), atol=0.01)
    assert search.moved(frames[0]).time_s == frames[0].time_s + search.offsets_s[frames[0].camera]


def test_camera_without_pictures_and_still_people_are_refused(room: Simulation, frames: list[DetectedFrame]) -> None:
    with pytest.raises(InputError, match="Too few pictures") as error:
        find_offsets(room.cameras, [frame for frame in frames if frame.camera != 1], room.joints)
    assert [problem.camera for problem in error.value.problems] == ["cam_01"]
    still = [
        frame._replace(points_px=frames[frame.camera].points_px, score=frames[frame.camera].score) for frame in frames
    ]
    with pytest.raises(InputError) as error:
        find_offsets(room.cameras, still, room.joints)
    assert all(problem.hint for problem in error.value.problems)
