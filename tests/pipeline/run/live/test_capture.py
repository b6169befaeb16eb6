"""Frames of cameras in, people at instants out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.run.live import frames as waiting
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import DetectedFrame, LiveInstant
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.conftest import body, detections_of
from tests.pipeline.run.live.streams import play, sent_frames
from tests.type_checker import of_wrong_types

RATE_HZ = 25.0


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=4.0), 1)


def capture_of(simulation: Simulation, settings: LiveSettings | None = None) -> LiveCapture:
    return LiveCapture(simulation.cameras, simulation.joints, settings or LiveSettings(RATE_HZ))


def contents(instants: list[LiveInstant]) -> list[tuple[float, list[tuple[int, bytes]]]]:
    return [
        (instant.time_s, [(person.id, person.xyz_m.tobytes()) for person in instant.people]) for instant in instants
    ]


def test_positions_are_those_of_finished_session(room: Simulation) -> None:
    """Cameras in step, before bones are learnt: positions need no later frame, except where views disagree."""
    instants = play(capture_of(room, LiveSettings(RATE_HZ, learn_s=60.0)), sent_frames(room))
    parameters = derive_parameters(room.cameras, RATE_HZ)
    tracks, _ = reconstruct_tracks(room.cameras, room.times, room.detections, room.timebase, parameters)
    np.testing.assert_allclose([instant.time_s for instant in instants], np.arange(len(instants)) / RATE_HZ)
    assert len(instants) == room.timebase.num_frames
    assert {person.id for instant in instants for person in instant.people} == {1, 2, 3} == {t.track_id for t in tracks}
    num_same = num_all = 0
    for frame, instant in enumerate(instants):
        for person in instant.people:
            there_m = [t.xyz_m[frame - t.start_frame] for t in tracks if frame in t.frames]
            apart_m = [np.linalg.norm(other_m - person.xyz_m, axis=-1) for other_m in there_m]
            nearest_m = min(apart_m, key=np.nanmean)
            num_same += int((nearest_m < 1e-9).sum())
            num_all += int(np.isfinite(nearest_m).sum())
    assert num_same > 0.97 * num_all
    assert num_all > 0.9 * 3 * 17 * (room.timebase.num_frames - 3)


def test_instant_is_final_with_last_camera(room: Simulation) -> None:
    """No instant waits for a later frame if all cameras send theirs."""
    capture = capture_of(room)
    for frame in sent_frames(room):
        instants = capture.push(*frame)
        is_last = frame.camera == len(room.cameras) - 1
        assert [instant.time_s for instant in instants] == ([frame.time_s] if is_last else [])
        assert all(instant.lag_s == 0.0 for instant in instants)


def shuffled(frames: list[DetectedFrame], within_s: float) -> list[DetectedFrame]:
    """Frames as a network may deliver them, each up to so much later than it should come."""
    rng = np.random.default_rng(5)
    return sorted(frames, key=lambda frame: frame.time_s + rng.uniform(0.0, within_s))


def test_frames_out_of_order_within_window_change_nothing(room: Simulation) -> None:
    frames = sent_frames(room)
    expected = play(capture_of(room, LiveSettings(RATE_HZ, window_s=0.2, is_ordered=False)), frames)
    capture = capture_of(room, LiveSettings(RATE_HZ, window_s=0.2, is_ordered=False))
    instants = play(capture, shuffled(frames, 0.15))
    assert contents(instants) == contents(expected)
    assert capture.counts.taken == len(frames)
    assert capture.counts.late > len(frames) // 3
    assert capture.counts.dropped == 0


def test_camera_late_within_window_changes_nothing(room: Simulation) -> None:
    """Frames that are in the order of each camera are waited for no longer than needed."""
    frames = sent_frames(room)
    behind = sorted(frames, key=lambda frame: frame.time_s + (0.081 if frame.camera == 2 else 0.0))
    capture = capture_of(room, LiveSettings(RATE_HZ, window_s=0.2))
    instants = play(capture, behind)
    assert contents(instants) == contents(play(capture_of(room), frames))
    assert max(instant.lag_s for instant in instants) < 0.085
    assert capture.counts.late > 0


def test_frames_behind_window_are_dropped_and_counted(room: Simulation) -> None:
    frames = sent_frames(room)
    late = next(frame for frame in frames if frame.camera == 1 and frame.time_s > 1.0)
    others = [frame for frame in frames if frame is not late]
    place = next(number for number, frame in enumerate(others) if frame.time_s > late.time_s + 0.15)
    capture = capture_of(room)
    instants = play(capture, [*others[:place], late, *others[place:]])
    assert capture.counts.dropped == 1
    assert capture.counts.taken == len(frames) - 1
    assert contents(instants) == contents(play(capture_of(room), others))


def test_frame_that_comes_twice_is_dropped(room: Simulation) -> None:
    frames = sent_frames(room)
    capture = capture_of(room)
    instants = play(capture, [frame for frame in frames for _ in range(2)])
    assert contents(instants) == contents(play(capture_of(room), frames))
    assert capture.counts.dropped == len(frames)


def test_silent_camera_is_not_waited_for(room: Simulation) -> None:
    """After the window, the other three go on without lag; when it is back, it takes part again."""
    frames = [frame for frame in sent_frames(room) if frame.camera != 0 or not 1.0 < frame.time_s < 2.0]
    capture = capture_of(room)
    lags_s = {}
    for frame in frames:
        for instant in capture.push(*frame):
            lags_s[round(instant.time_s, 3)] = instant.lag_s
            assert len(instant.people) == 3 or instant.time_s < 0.2
    assert max(lags_s.values()) <= 0.16
    assert max(lag_s for time_s, lag_s in lags_s.items() if time_s > 1.2) == 0.0
    assert capture.counts.dropped == 0


def test_output_rate_is_its_own(room: Simulation) -> None:
    instants = play(capture_of(room, LiveSettings(RATE_HZ, output_rate_hz=10.0)), sent_frames(room))
    np.testing.assert_allclose(np.diff([instant.time_s for instant in instants]), 0.1)
    assert all(len(instant.people) == 3 for instant in instants[3:])


def test_pauses_give_no_endless_row_of_instants(ring: tuple[Camera, ...]) -> None:
    """The cameras stop for a day; instants without frames are left out."""
    capture = LiveCapture(ring, COCO_17, LiveSettings(RATE_HZ))
    instants = []
    for start_s in (0.0, 86400.0):
        for frame in range(10):
            for number, camera in enumerate(ring):
                seen = detections_of(camera, body()[None, None])
                instants += capture.push(number, start_s + frame / RATE_HZ, seen.keypoints_px, seen.score)
    instants += capture.flush()
    assert len(instants) < 20 + 2 * RATE_HZ
    assert sum(bool(instant.people) for instant in instants) >= 14
    assert {person.id for instant in instants for person in instant.people} == {1, 2}


def test_frames_that_wait_are_few(ring: tuple[Camera, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera that sends far too many frames: the earliest are processed before their time."""
    monkeypatch.setattr(waiting, "_MOST_WAITING", 50)
    capture = LiveCapture(ring, COCO_17, LiveSettings(RATE_HZ))
    none_px, no_score = np.empty((0, 17, 2)), np.empty((0, 17))
    kept = []
    for number in range(500):
        capture.push("cam0", 1e-6 * number, none_px, no_score)
        kept.append(capture.num_kept)
    assert max(kept) == 50


def test_everything_wrong_with_frame_is_said_at_once(ring: tuple[Camera, ...]) -> None:
    capture = LiveCapture(ring, COCO_17, LiveSettings(RATE_HZ))
    with pytest.raises(InputError) as caught:
        capture.push("cam9", np.nan, np.zeros((1, 16, 2)), np.ones((1, 16)))
    assert [problem.field for problem in caught.value.problems] == ["camera", "time_s", "points_px"]
    assert "cam0, cam1, cam2, cam3" in str(caught.value)
    assert "(people, 17, 2)" in str(caught.value)
    with pytest.raises(InputError, match="from 0 to 1"):
        capture.push(0, 0.0, np.zeros((1, 17, 2)), np.full((1, 17), np.nan))
    with pytest.raises(InputError, match="at most 128 bodies"):
        capture.push(0, 0.0, np.zeros((129, 17, 2)), np.ones((129, 17)))
    assert capture.counts.taken == 0


def test_settings_are_checked_at_once() -> None:
    with pytest.raises(InputError) as caught:
        LiveSettings(0.0, output_rate_hz=np.inf, window_s=-1.0, learn_s=3.0)
    assert [problem.field for problem in caught.value.problems] == ["frame_rate_hz", "output_rate_hz", "window_s"]


def test_cameras_have_names_of_their_own(ring: tuple[Camera, ...]) -> None:
    for cameras in (ring[:1], [ring[0], ring[0]]):
        with pytest.raises(InputError, match="two cameras, with different names"):
            LiveCapture(cameras, COCO_17, LiveSettings(RATE_HZ))


@of_wrong_types
@pytest.mark.parametrize(
    ("frame", "fields"),
    [
        ((0.5, 0.0, np.zeros((1, 17, 2)), np.ones((1, 17))), ["camera"]),
        ((None, "now", np.zeros((1, 17, 2)), np.ones((1, 17))), ["camera", "time_s"]),
        ((0, 1j, 3, "x"), ["time_s", "points_px"]),
        ((0, 0.0, [[[1, 2]] * 17, [[3, 4]] * 16], np.ones((2, 17))), ["points_px"]),
        ((0, 0.0, np.full((1, 17, 2), np.inf), np.full((1, 17), 2.0)), ["score", "points_px"]),
        ((0, 0.0, np.full((1, 17, 2), -2e6), np.ones((1, 17))), ["points_px"]),
    ],
)
def test_no_frame_is_problem(ring: tuple[Camera, ...], frame: tuple[Any, ...], fields: list[str]) -> None:
    capture = LiveCapture(ring, COCO_17, LiveSettings(RATE_HZ))
    with pytest.raises(InputError) as caught:
        capture.push(*frame)
    assert [problem.field for problem in caught.value.problems] == fields
    right: tuple[Any, ...] = (np.int64(1), np.float32(0.0), [[[1, 2]] * 17], [[1] * 17])
    capture.push(*right)
    assert capture.counts.taken == 1
