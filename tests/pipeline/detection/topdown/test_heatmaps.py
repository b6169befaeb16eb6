import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detection.topdown.blazepose import read_near


def heatmap(x: float, y: float, peak: float = 0.9, sigma: float = 1.0, size: int = 64) -> np.ndarray:
    """Logits of a Gaussian."""
    rows, columns = np.indices((size, size))
    heat = peak * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))
    return np.log(heat.clip(1e-9) / (1 - heat.clip(None, 1 - 1e-9)))


@given(st.floats(8, 55), st.floats(8, 55))
def test_peak_is_located_to_fraction_of_cell(x: float, y: float) -> None:
    position, peak = read_near(heatmap(x, y)[None], np.array([[x + 0.3, y - 0.4]]))
    np.testing.assert_allclose(position, [[x, y]], atol=0.1)
    assert 0.6 < peak[0] <= 0.9


def test_each_map_is_read_near_its_own_expected_position_alone() -> None:
    both = np.maximum(heatmap(20, 30, 0.7), heatmap(40, 30, 0.95))
    position, peak = read_near(np.stack([both, both]), np.array([[21.0, 29.0], [39.0, 31.0]]))
    np.testing.assert_allclose(position, [[20, 30], [40, 30]], atol=0.05)
    np.testing.assert_allclose(peak, [0.7, 0.95], atol=1e-6)


def test_peak_beyond_window_is_not_read() -> None:
    _, peak = read_near(heatmap(30, 30, sigma=0.5)[None], np.array([[35.0, 30.0]]))
    assert peak[0] < 0.01


@pytest.mark.parametrize("expected", [(np.nan, np.nan), (-0.6, 5.0), (5.0, 63.6), (-1e30, 4.0)])
def test_without_expected_position_in_map_nothing_is_read(expected: tuple[float, float]) -> None:
    position, peak = read_near(heatmap(1, 5)[None], np.array([expected]))
    assert np.isnan(position).all()
    assert peak[0] == 0


def test_windows_end_at_maps_border() -> None:
    position, peak = read_near(heatmap(0, 63)[None], np.array([[0.0, 63.0]]))
    assert peak[0] == pytest.approx(0.9)
    x, y = position[0]
    assert 0 < x < 1.2
    assert 61.8 < y < 63
