import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.data.detections import MapGrid
from pipeline.core.data.turns import is_quarter_turn, turned_axes, upright_size_px


def test_axes_of_picture_turned_to_left() -> None:
    # An axis to the right points up, and an axis down points to the right.
    np.testing.assert_array_equal(np.array([(1.0, 0.0), (0.0, 1.0)]) @ turned_axes(90.0), [(0.0, -1.0), (1.0, 0.0)])
    np.testing.assert_array_equal(turned_axes(180.0), -np.eye(2))
    np.testing.assert_array_equal(turned_axes(-90.0), turned_axes(270.0))
    assert not np.signbit(turned_axes(0.0)).any()


@given(first=st.floats(-400.0, 400.0), second=st.floats(-400.0, 400.0))
def test_turns_add_up(first: float, second: float) -> None:
    np.testing.assert_allclose(turned_axes(first) @ turned_axes(second), turned_axes(first + second), atol=1e-9)
    np.testing.assert_allclose(turned_axes(first) @ turned_axes(first).T, np.eye(2), atol=1e-12)


@pytest.mark.parametrize(
    ("turn_deg", "size_px"), [(0, (4, 3)), (30, (4, 3)), (60, (3, 4)), (180, (4, 3)), (270, (3, 4))]
)
def test_size_follows_nearest_quarter(turn_deg: float, size_px: tuple[int, int]) -> None:
    assert upright_size_px((4, 3), turn_deg) == size_px
    assert is_quarter_turn(turn_deg) == (turn_deg not in {30, 60})


@given(turn_deg=st.floats(-360.0, 360.0), x=st.floats(-500.0, 4000.0), y=st.floats(-500.0, 4000.0))
def test_cells_of_turned_maps_and_pixels_are_inverse(turn_deg: float, x: float, y: float) -> None:
    grid = MapGrid((3.5, 900.0), (8.0, 8.1), turn_deg)
    np.testing.assert_allclose(grid.image_from_map(grid.map_from_image(np.array([x, y]))), [x, y], atol=1e-8)
    np.testing.assert_array_equal(grid.image_from_map(np.zeros(2)), [3.5, 900.0])


def test_columns_of_picture_turned_left_run_left() -> None:
    grid = MapGrid((100.0, 50.0), (8.0, 10.0), 90.0)
    np.testing.assert_array_equal(grid.image_from_map(np.array([0.0, 1.0])), [90.0, 50.0])
    np.testing.assert_array_equal(grid.image_from_map(np.array([1.0, 0.0])), [100.0, 58.0])
