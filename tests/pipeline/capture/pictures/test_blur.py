"""Blur of drawn pictures, whose edges are as wide as they were made."""

import cv2
import numpy as np
import pytest

from pipeline.capture.pictures.figures import blur_px
from tests.pipeline.capture.pictures.rooms import room

GREY = cv2.cvtColor(room(0, (960, 540)), cv2.COLOR_RGB2GRAY)


@pytest.mark.parametrize("width_px", [1.5, 3.0, 5.0, 8.0])
def test_width_of_edges_is_measured(width_px: float) -> None:
    """The sharpest quarter of the edges is narrower than the mean: corners and neighbours make edges look sharper."""
    assert 0.65 * width_px < blur_px(cv2.GaussianBlur(GREY, (0, 0), width_px)) < 1.15 * width_px


def test_contrast_and_brightness_do_not_count() -> None:
    blurred = cv2.GaussianBlur(GREY, (0, 0), 4.0)
    faint = np.round(30 + 0.4 * blurred.astype(float)).astype(np.uint8)
    assert blur_px(faint) == pytest.approx(blur_px(blurred), rel=0.12)


def test_sharp_picture_with_blurred_background_is_sharp() -> None:
    """The camera is focused on the people, who are a tenth of the picture."""
    image = cv2.GaussianBlur(GREY, (0, 0), 6.0)
    image[:, 400:660] = GREY[:, 400:660]
    assert blur_px(image) < 1.0


def test_noise_does_not_make_picture_blurred() -> None:
    rng = np.random.default_rng(0)
    noisy = np.clip(GREY + rng.normal(0, 8, GREY.shape), 0, 255).astype(np.uint8)
    assert blur_px(noisy) < 1.0


def test_uniform_picture_has_no_edges() -> None:
    assert np.isnan(blur_px(np.full((90, 160), 80, np.uint8)))
