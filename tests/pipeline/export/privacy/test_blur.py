"""Blurred ellipses: what is left of a face is a few means, and all around it stays as it was."""

import cv2
import numpy as np
import pytest

from pipeline.export.privacy.blur import blur_ellipses


def patterned(height: int = 240, width: int = 320, seed: int = 1) -> np.ndarray:
    """Picture with as much detail at every scale as a face has, in any place."""
    noise = np.random.default_rng(seed).normal(size=(height, width, 3))
    octaves = [cv2.GaussianBlur(noise, (0, 0), sigma) * sigma for sigma in (0.7, 1.5, 3.0, 6.0)]
    return np.clip(128 + 60 * np.sum(octaves, axis=0), 0, 255).astype(np.uint8)


def detail(image: np.ndarray) -> float:
    """Mean energy of all that is finer than a sixteenth of a picture's shorter side."""
    coarse = cv2.GaussianBlur(image.astype(float), (0, 0), min(image.shape[:2]) / 16)
    return float(np.mean((image - coarse) ** 2))


@pytest.mark.parametrize("radius_px", [10.0, 24.0, 60.0])
def test_no_detail_of_a_face_is_left(radius_px: float) -> None:
    image = patterned()
    blurred = blur_ellipses(image, np.array([[160.0, 120.0, radius_px, 1.3 * radius_px]]))
    inner = (
        slice(round(120 - 0.6 * radius_px), round(120 + 0.6 * radius_px)),
        slice(round(160 - 0.6 * radius_px), round(160 + 0.6 * radius_px)),
    )
    assert detail(blurred[inner]) < 0.05 * detail(image[inner])


def test_faces_that_differ_in_detail_alone_become_equal() -> None:
    """Nothing that is finer than a cell decides what is shown: it can't be computed from it."""
    image = patterned()
    ellipse_px = np.array([[160.0, 120.0, 40.0, 40.0]])
    other = image.copy()
    # Each cell of 20 pixels has the same mean of two columns side by side.
    part = other[80:160, 120:200].reshape(80, 40, 2, 3)
    other[80:160, 120:200] = part[:, :, ::-1].reshape(80, 80, 3)
    shown, shown_other = (blur_ellipses(picture, ellipse_px)[95:145, 135:185].astype(int) for picture in (image, other))
    assert np.abs(image[80:160, 120:200].astype(int) - other[80:160, 120:200]).mean() > 10
    assert np.abs(shown - shown_other).max() <= 2


def test_what_lies_outside_stays_as_it_was() -> None:
    image = patterned()
    blurred = blur_ellipses(image, np.array([[100.0, 60.0, 20.0, 30.0]]))
    rows, columns = np.mgrid[:240, :320]
    is_outside = ((columns - 100) / 20) ** 2 + ((rows - 60) / 30) ** 2 > 1
    np.testing.assert_array_equal(blurred[is_outside], image[is_outside])
    assert (blurred[~is_outside] != image[~is_outside]).any(axis=-1).mean() > 0.9


def test_ellipses_at_the_edge_and_beyond_it() -> None:
    image = patterned()
    far = np.array([[-500.0, 60.0, 20.0, 30.0], [160.0, 900.0, 20.0, 30.0]])
    np.testing.assert_array_equal(blur_ellipses(image, far), image)
    np.testing.assert_array_equal(blur_ellipses(image, np.empty((0, 4))), image)
    at_edge = blur_ellipses(image, np.array([[0.0, 120.0, 30.0, 30.0]]))
    assert detail(at_edge[105:135, :15]) < 0.02 * detail(image[105:135, :15])
    whole = blur_ellipses(image, np.array([[160.0, 120.0, 320.0, 240.0]]))
    assert detail(whole) < 0.02 * detail(image)


def test_a_tiny_head_is_blurred_too() -> None:
    image = np.zeros((60, 60, 3), np.uint8)
    image[::2] = 255
    blurred = blur_ellipses(image, np.array([[30.0, 30.0, 4.0, 4.0]]))
    assert np.ptp(blurred[29:32, 29:32].astype(int)) < 160
