from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from pipeline.core.joints import COCO_17, JointSet
from pipeline.detection.between import Picture, bodies_between, interpolate, pair_bodies, schedule_detections
from pipeline.detection.bodies import ImageBodies, boxes_around
from tests.pipeline.detection.topdown.people import standing_px

# Size of the standing body: the diagonal of the box around its joints.
SIZE_PX = float(np.linalg.norm(np.ptp(standing_px(), axis=0)))
NUM_FRAMES = 40
TIME_30_HZ = np.arange(NUM_FRAMES) / 30


@dataclass
class BodiesByFrame:
    """Detector of the bodies at known places in each frame, whose pictures hold their numbers; it counts its work."""

    places_px: list[list[np.ndarray]]  # Offset of each body from the standing one in each frame
    joints: JointSet = COCO_17
    seen: list[int] = field(default_factory=list)

    def detect(self, image_rgb: np.ndarray) -> ImageBodies:
        frame = int(image_rgb[0, 0, 0])
        self.seen.append(frame)
        keypoints_px = np.array([standing_px() + place for place in self.places_px[frame]]).reshape(-1, 17, 2)
        score = np.full(keypoints_px.shape[:2], 0.4 + 0.01 * frame)
        return ImageBodies(keypoints_px, score, boxes_around(keypoints_px), score[:, 0] + 0.1)


def pictures(frames: range, missing: tuple[int, ...] = ()) -> Iterator[Picture]:
    """Pictures that share their memory, as those of the decoder."""
    image_rgb = np.zeros((2, 2, 3), np.uint8)
    for frame in frames:
        if frame not in missing:
            image_rgb[:] = frame
            yield frame, image_rgb
    image_rgb[:] = 255


def walking(step_px: float) -> list[list[np.ndarray]]:
    return [[np.array([step_px * frame, 0.0])] for frame in range(NUM_FRAMES)]


def run(
    detector: BodiesByFrame, frames: range = range(NUM_FRAMES), longest_s: float = 0.067, missing: tuple[int, ...] = ()
) -> dict[int, ImageBodies]:
    """Bodies of a range of frames at 30 Hz by frame; the picture of each frame is its own."""
    schedule = schedule_detections(TIME_30_HZ, frames, longest_s)
    found = {}
    for frame, image_rgb, bodies in bodies_between(pictures(schedule.frames, missing), detector, schedule):
        assert (image_rgb == frame).all()
        if frame in frames:
            found[frame] = bodies
    assert list(found) == [frame for frame in frames if frame not in missing]
    return found


@pytest.mark.parametrize(
    ("rate_hz", "longest_s", "detected"),
    [
        (30.0, 0.04, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
        (50.0, 0.04, (0, 2, 4, 6, 8)),
        (60000 / 1001, 0.04, (0, 2, 4, 6, 8)),
        (30.0, 0.067, (0, 2, 4, 6, 8)),
        (30.0, 0.034, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
        (25.0, 0.067, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
        (25.0, 0.08, (0, 2, 4, 6, 8)),
        (60.0, 0.067, (0, 4, 8)),
        (240.0, 0.067, (0, 4, 8)),  # at most four frames
        (4.0, 0.067, (0, 1, 2, 3, 4, 5, 6, 7, 8)),
        (4.0, 0.6, (0, 2, 4, 6, 8)),
    ],
)
def test_detections_are_scheduled_by_time(rate_hz: float, longest_s: float, detected: tuple[int, ...]) -> None:
    assert schedule_detections(np.arange(9) / rate_hz, range(9), longest_s).detected == detected


def test_frames_that_were_dropped_count_by_their_time() -> None:
    time_s = np.delete(np.arange(12) / 30, [3, 4, 5])
    # Frames 2 and 3 are 0.13 s apart.
    assert schedule_detections(time_s, range(9), 0.067).detected == (0, 2, 3, 5, 7, 8)


@given(
    steps_s=st.lists(st.floats(0.0, 0.4), min_size=1, max_size=80),
    longest_s=st.floats(0.001, 0.2),
    data=st.data(),
)
def test_schedule_does_not_depend_on_range(steps_s: list[float], longest_s: float, data: st.DataObject) -> None:
    time_s = 7.25 + np.cumsum(steps_s)
    whole = schedule_detections(time_s, range(len(time_s)), longest_s).detected
    assert whole[0] == 0
    assert whole[-1] == len(time_s) - 1
    gaps = np.diff(whole)
    assert (gaps <= 4).all()
    assert ((np.diff(time_s[list(whole)]) <= longest_s + 1e-4) | (gaps == 1)).all()
    start = data.draw(st.integers(0, len(time_s) - 1))
    stop = data.draw(st.integers(start + 1, len(time_s)))
    part = schedule_detections(time_s, range(start, stop), longest_s)
    first = max(place for place, frame in enumerate(whole) if frame <= start)
    last = min(place for place, frame in enumerate(whole) if frame >= stop - 1)
    assert part.detected == whole[first : last + 1]


def test_body_that_walks_is_detected_in_every_second_frame() -> None:
    detector = BodiesByFrame(walking(0.02 * SIZE_PX))
    found = run(detector)
    assert detector.seen == [*range(0, 30, 2), *range(30, NUM_FRAMES, 2), NUM_FRAMES - 1]
    for frame, bodies in found.items():
        assert_allclose(bodies.keypoints_px[0], standing_px() + detector.places_px[frame][0])
        assert_allclose(bodies.score, 0.4 + 0.01 * frame)
        assert_allclose(bodies.center_score, 0.5 + 0.01 * frame)
        assert_allclose(bodies.box_px[0, :2], bodies.keypoints_px[0].min(0))


def test_body_that_moves_fast_is_detected_in_every_frame() -> None:
    detector = BodiesByFrame(walking(0.11 * SIZE_PX))
    run(detector)
    assert sorted(detector.seen) == list(range(NUM_FRAMES))


def test_one_fast_hand_makes_frames_detected() -> None:
    wrist = COCO_17.indices(("left_wrist",))
    places = [[np.zeros((17, 2))] for _ in range(NUM_FRAMES)]
    for frame in range(10, 16):
        places[frame][0][wrist] = (frame - 9) * 0.2 * SIZE_PX
    detector = BodiesByFrame(places)
    found = run(detector)
    assert set(range(10, 17)) <= set(detector.seen)
    assert not {3, 5, 7, 19, 21} & set(detector.seen)
    assert_array_equal(found[11].keypoints_px[0], standing_px() + places[11][0])


def bodies_with_wrist(step_px: float, score: float) -> ImageBodies:
    """Standing body whose left wrist is moved and has a score of its own."""
    keypoints_px, scores = standing_px()[None].copy(), np.full((1, 17), 0.8)
    wrist = COCO_17.index("left_wrist")
    keypoints_px[0, wrist, 0] += step_px
    scores[0, wrist] = score
    return ImageBodies(keypoints_px, scores, boxes_around(keypoints_px), np.array([0.8]))


def test_unsure_joint_that_jumps_is_missing_between() -> None:
    before, after = bodies_with_wrist(0.0, 0.8), bodies_with_wrist(0.3 * SIZE_PX, 0.39)
    pairs = pair_bodies(before, after)
    assert pairs is not None
    between = interpolate(before, after, pairs, 0.5)
    assert np.flatnonzero(np.isnan(between.keypoints_px[0, :, 0])) == COCO_17.index("left_wrist")
    assert np.flatnonzero(between.score[0] == 0) == COCO_17.index("left_wrist")
    assert pair_bodies(before, bodies_with_wrist(0.3 * SIZE_PX, 0.41)) is None


def test_bodies_elsewhere_on_average_are_not_paired() -> None:
    before, after = bodies_with_wrist(0.0, 0.3), bodies_with_wrist(0.0, 0.3)
    after = replace(after, keypoints_px=after.keypoints_px + 0.11 * SIZE_PX, score=np.full((1, 17), 0.3))
    assert pair_bodies(before, after) is None


@pytest.mark.parametrize("entered", [12, 13])
def test_body_that_enters_is_found_in_its_first_frame(entered: int) -> None:
    places = [[np.zeros(2)] + [np.array([200.0, 0.0])] * (frame >= entered) for frame in range(NUM_FRAMES)]
    found = run(BodiesByFrame(places))
    assert [len(bodies.score) for bodies in found.values()] == [1 + (frame >= entered) for frame in range(NUM_FRAMES)]


def test_bodies_keep_their_joints_when_their_order_changes() -> None:
    left, right = np.zeros(2), np.array([200.0, 0.0])
    places = [[left, right] if frame % 4 else [right, left] for frame in range(NUM_FRAMES)]
    detector = BodiesByFrame(places)
    found = run(detector)
    assert 1 not in detector.seen
    expected_px = [standing_px() + right, standing_px() + left]
    assert_allclose(found[1].keypoints_px, expected_px)


def test_joint_that_one_detection_lacks_is_missing_between() -> None:
    @dataclass
    class WithoutNose(BodiesByFrame):
        def detect(self, image_rgb: np.ndarray) -> ImageBodies:
            bodies = super().detect(image_rgb)
            if image_rgb[0, 0, 0] % 4 == 0:
                bodies.keypoints_px[:, 0], bodies.score[:, 0] = np.nan, 0.0
            return bodies

    (bodies,) = run(WithoutNose(walking(0.0)), range(1, 2)).values()
    assert np.isnan(bodies.keypoints_px[0, 0]).all()
    assert bodies.score[0, 0] == 0.0
    assert np.isfinite(bodies.keypoints_px[0, 1:]).all()


def test_frames_beside_missing_picture_are_detected() -> None:
    detector = BodiesByFrame(walking(1.0))
    run(detector, missing=(8, NUM_FRAMES - 1))
    assert {7, 9, NUM_FRAMES - 2} <= set(detector.seen)
    assert not {5, 11} & set(detector.seen)


def test_frames_without_bodies_are_not_detected_between_others() -> None:
    detector = BodiesByFrame([[] for _ in range(NUM_FRAMES)])
    assert all(bodies.keypoints_px.shape == (0, 17, 2) for bodies in run(detector).values())
    assert len(detector.seen) == NUM_FRAMES // 2 + 1


@given(
    longest_s=st.sampled_from([0.034, 0.067, 0.1, 0.134, 0.2]),
    steps_px=st.lists(st.floats(0.0, 0.08 * SIZE_PX), min_size=NUM_FRAMES, max_size=NUM_FRAMES),
    missing=st.lists(st.integers(0, NUM_FRAMES - 1), max_size=3).map(tuple),
    cuts=st.lists(st.integers(1, NUM_FRAMES - 1), max_size=6),
)
def test_cut_into_ranges_changes_no_bit(
    longest_s: float, steps_px: list[float], missing: tuple[int, ...], cuts: list[int]
) -> None:
    places = [[np.array([place, 0.0])] for place in np.cumsum(steps_px)]
    whole = run(BodiesByFrame(places), longest_s=longest_s, missing=missing)
    borders = [0, *sorted(set(cuts)), NUM_FRAMES]
    for start, stop in pairwise(borders):
        for frame, bodies in run(BodiesByFrame(places), range(start, stop), longest_s, missing).items():
            assert_array_equal(bodies.keypoints_px, whole[frame].keypoints_px)
            assert_array_equal(bodies.score, whole[frame].score)
