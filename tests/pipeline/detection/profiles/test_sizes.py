"""Sizes follow the people of a camera, not its images."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detection.bodies import ImageBodies
from pipeline.detection.profiles.sizes import RULES, CameraSizes, SizeRule, body_spans_px, choose_sizes

RULE = SizeRule(span_px=230.0, max_px=800)


def spans(*frames: list[float]) -> list[np.ndarray]:
    return [np.array(frame, np.float64) for frame in frames]


def wide(height: float, width: float, num_sure: int) -> ImageBodies:
    """Body with joints at the corners of a box, and as many sure joints."""
    keypoints_px = np.full((1, 17, 2), 50.0)
    keypoints_px[0, 0] = 50.0 + width, 50.0
    keypoints_px[0, 1] = 50.0, 50.0 + height
    score = np.where(np.arange(17) < num_sure, 0.9, 0.1)[None]
    return ImageBodies(keypoints_px, score, np.array([[50.0, 50.0, 50.0 + width, 50.0 + height]]), np.array([0.8]))


def test_span_is_longer_side_around_sure_joints() -> None:
    assert body_spans_px(wide(120.0, 40.0, 8)).tolist() == [120.0]
    assert body_spans_px(wide(30.0, 90.0, 17)).tolist() == [90.0]
    assert np.isnan(body_spans_px(wide(120.0, 40.0, 7))).all()
    far = wide(120.0, 40.0, 8)
    far.keypoints_px[0, 16] = 5000.0  # a joint that is not sure
    assert body_spans_px(far).tolist() == [120.0]


def test_span_is_measured_in_upright_picture() -> None:
    leaning = wide(100.0, 100.0, 8)
    assert body_spans_px(leaning, 90.0).tolist() == [100.0]
    # From the corner in the middle, both sides of the square rise by 100 / sqrt(2).
    np.testing.assert_allclose(body_spans_px(leaning, 45.0), [100.0 * math.sqrt(2.0)])


@given(
    tall_px=st.floats(60.0, 900.0),
    size_px=st.sampled_from([(1920, 1080), (1080, 1920), (640, 480), (1088, 1920), (3840, 2160)]),
)
def test_tallest_body_spans_what_rule_says_within_limits(tall_px: float, size_px: tuple[int, int]) -> None:
    sizes = choose_sizes(spans([tall_px], [tall_px]), size_px, RULE)
    (longer_px,) = sizes.scaled_px
    assert longer_px <= RULE.max_px
    wanted = min(max(230.0 / tall_px * max(size_px), 256), RULE.max_px)
    assert longer_px == pytest.approx(wanted, rel=0.06, abs=1.0)


@pytest.mark.parametrize(("size_px", "expected"), [((1920, 1080), (512, 288)), ((640, 480), (512, 384))])
def test_without_people_images_have_usual_size(size_px: tuple[int, int], expected: tuple[int, int]) -> None:
    longer_px, shorter_px = expected
    for nobody in (spans(), spans([], []), spans([math.nan])):
        assert choose_sizes(nobody, size_px, RULE) == CameraSizes((longer_px,))
    assert round(longer_px * min(size_px) / max(size_px)) == shorter_px


def test_near_size_with_less_padding_is_preferred() -> None:
    # 500 x 281 pixels would be padded to 512 x 288, which has no padding at 512.
    assert choose_sizes(spans([230.0 * 1920 / 500]), (1920, 1080), RULE).scaled_px == (512,)


def test_person_who_passes_near_camera_for_moment_does_not_count() -> None:
    standing = spans(*[[200.0, 180.0]] * 11, [600.0])
    assert choose_sizes(standing, (640, 480), RULE) == choose_sizes(standing[:-1], (640, 480), RULE)


def test_people_of_very_different_size_get_two_passes() -> None:
    sizes = choose_sizes(spans(*[[900.0, 300.0]] * 4), (1920, 1080), RULE)
    coarse_px, fine_px = sizes.scaled_px
    assert coarse_px == pytest.approx(230 / 900 * 1920, rel=0.06)
    assert fine_px == pytest.approx(800, rel=0.06)
    assert sizes.border_px == pytest.approx(math.sqrt(900 * 300))
    assert len(choose_sizes(spans(*[[900.0, 400.0]] * 4), (1920, 1080), RULE).scaled_px) == 1


def test_fast_images_are_smaller() -> None:
    one, other = (choose_sizes(spans([220.0]), (640, 480), RULES[name]).scaled_px for name in ("fast", "balanced"))
    assert one < other
