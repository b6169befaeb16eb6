"""Bodies of two passes: each person once, from the pass that sees it at the right size."""

import numpy as np

from pipeline.detection.bodies import ImageBodies
from pipeline.detection.profiles.profile_detector import merge_passes

BORDER_PX = 300.0
# A body as a share of its height: head, arms, hips, legs.
SHAPE = np.stack([np.tile([0.45, 0.5, 0.55], 6)[:17], np.linspace(0.0, 1.0, 17)], axis=-1)


def body(x_px: float, height_px: float, score: float = 0.9) -> ImageBodies:
    keypoints_px = SHAPE * height_px + np.array([x_px, 40.0])
    return of(keypoints_px[None], np.full((1, 17), score))


def of(keypoints_px: np.ndarray, score: np.ndarray) -> ImageBodies:
    low, high = np.nanmin(keypoints_px, axis=1), np.nanmax(keypoints_px, axis=1)
    return ImageBodies(keypoints_px, score, np.concatenate([low, high], axis=-1), score.max(-1))


def together(*bodies: ImageBodies) -> ImageBodies:
    return ImageBodies(*(np.concatenate([getattr(one, name) for one in bodies]) for name in ImageBodies.__slots__))


def nobody() -> ImageBodies:
    return ImageBodies(np.empty((0, 17, 2)), np.empty((0, 17)), np.empty((0, 4)), np.empty(0))


def part(whole: ImageBodies, joints: slice, shift_px: float) -> ImageBodies:
    """A body with some of the joints of another one only, a little beside them."""
    keypoints_px, score = np.full_like(whole.keypoints_px, np.nan), np.zeros_like(whole.score)
    keypoints_px[:, joints] = whole.keypoints_px[:, joints] + shift_px
    score[:, joints] = 0.95
    return of(keypoints_px, score)


def heights(bodies: ImageBodies) -> list[float]:
    return sorted((bodies.box_px[:, 3] - bodies.box_px[:, 1]).round().tolist())


def test_tall_people_are_coarse_and_small_ones_fine() -> None:
    tall, small = body(100.0, 600.0, 0.8), body(700.0, 100.0, 0.6)
    fine = together(part(tall, slice(0, 9), 12.0), body(702.0, 101.0, 0.9))
    merged = merge_passes(together(tall, small), fine, BORDER_PX)
    assert heights(merged) == [101.0, 600.0]
    np.testing.assert_array_equal(merged.center_score, [0.9, 0.8])
    np.testing.assert_array_equal(merged.keypoints_px[1], tall.keypoints_px[0])


def test_bodies_that_one_pass_alone_finds_are_kept() -> None:
    tall, small = body(100.0, 600.0), body(700.0, 100.0)
    assert heights(merge_passes(tall, small, BORDER_PX)) == [100.0, 600.0]
    assert heights(merge_passes(together(tall, small), nobody(), BORDER_PX)) == [100.0, 600.0]
    assert heights(merge_passes(nobody(), tall, BORDER_PX)) == [600.0]


def test_small_person_before_tall_one_is_no_part_of_it() -> None:
    tall, small = body(100.0, 600.0), body(330.0, 90.0)
    assert heights(merge_passes(tall, small, BORDER_PX)) == [90.0, 600.0]


def test_nobody_is_nobody() -> None:
    assert merge_passes(nobody(), nobody(), BORDER_PX).score.shape == (0, 17)
