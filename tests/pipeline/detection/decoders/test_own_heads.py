"""Decoders of SimCC, heatmaps and RTMO."""

import numpy as np
import pytest

from pipeline.detection.own.own_detectors import decode_heatmaps, decode_rtmo, decode_simcc

SIZE_PX = (192, 256)


def bump(length: int, place: float, sigma: float = 2.0) -> np.ndarray:
    return np.asarray(np.exp(-((np.arange(length) - place) ** 2) / (2 * sigma**2)))


def test_simcc_reads_bins_of_both_axes() -> None:
    bins_x = np.stack([bump(384, 31), 0.5 * bump(384, 380)])
    bins_y = np.stack([0.8 * bump(512, 500), bump(512, 3)])
    points_px, score = decode_simcc(bins_x, bins_y, SIZE_PX)
    np.testing.assert_allclose(points_px, [[15.5, 250], [190, 1.5]])
    np.testing.assert_allclose(score, [0.8, 0.5])


@pytest.mark.parametrize("place", [(10.0, 20.0), (30.3, 41.8), (24.5, 7.25)])
def test_heatmaps_are_read_between_cells(place: tuple[float, float]) -> None:
    column, row = place
    heat = 0.9 * bump(64, row)[:, None] * bump(48, column)
    points_px, score = decode_heatmaps(heat[None], SIZE_PX)
    # Cells 0 and 47 are at pixels 0 and 191.
    expected = np.array([column * 191 / 47, row * 255 / 63])
    np.testing.assert_allclose(points_px[0], expected, atol=0.1)
    assert score[0] == pytest.approx(0.9, abs=0.06)


def test_peaks_at_border_and_flat_maps_stay_in_their_cells() -> None:
    corner = np.zeros((64, 48))
    corner[63, 47] = 1
    points_px, score = decode_heatmaps(np.stack([corner, np.zeros((64, 48))]), SIZE_PX)
    np.testing.assert_allclose(points_px, [[191, 255], [0, 0]])
    np.testing.assert_allclose(score, [1, 0])


def test_rtmo_keeps_certain_people_in_descending_order() -> None:
    boxes = np.array([[0, 0, 1, 1, 0.4], [0, 0, 1, 1, 0.1], [0, 0, 1, 1, 0.9]])
    keypoints = np.arange(18.0).reshape(3, 2, 3) / 10
    points_px, score, center_score = decode_rtmo(boxes, keypoints)
    np.testing.assert_allclose(center_score, [0.9, 0.4])
    np.testing.assert_allclose(points_px, keypoints[[2, 0], :, :2])
    np.testing.assert_allclose(score, np.array([[1, 1], [0.2, 0.5]]))


def test_rtmo_finds_nobody() -> None:
    points_px, score, center_score = decode_rtmo(np.zeros((0, 5)), np.zeros((0, 17, 3)))
    assert points_px.shape == (0, 17, 2)
    assert score.shape == (0, 17)
    assert center_score.shape == (0,)
