import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detection.topdown.regions import Region, crop, upward

REGIONS = st.builds(
    Region,
    st.tuples(st.floats(-500, 2000), st.floats(-500, 2000)),
    st.floats(10, 3000),
    st.floats(-np.pi, np.pi),
)


def draw_blob(size_px: tuple[int, int], center_px: np.ndarray, sigma_px: float) -> np.ndarray:
    width, height = size_px
    squared_px = (np.arange(width) - center_px[0]) ** 2 + ((np.arange(height) - center_px[1]) ** 2)[:, None]
    return np.repeat((255 * np.exp(-squared_px / (2 * sigma_px**2))).round().astype(np.uint8)[..., None], 3, axis=2)


def centroid_px(tensor: np.ndarray) -> np.ndarray:
    gray = tensor[0].sum(0).astype(float)
    return np.array([gray.sum(0) @ np.arange(gray.shape[1]), gray.sum(1) @ np.arange(gray.shape[0])]) / gray.sum()


@given(REGIONS, st.integers(16, 512))
def test_way_into_crop_and_back_changes_nothing(region: Region, crop_px: int) -> None:
    points_px = np.array([(0.0, 0.0), (640.0, 480.0), (-3.5, 1000.25), (np.nan, np.nan)])
    back_px = region.image_from_crop(region.crop_from_image(points_px, crop_px), crop_px)
    np.testing.assert_allclose(back_px, points_px, atol=1e-6)


@given(REGIONS, st.integers(16, 512))
def test_edges_of_region_are_edges_of_its_crop(region: Region, crop_px: int) -> None:
    up = np.array([np.sin(region.angle_rad), -np.cos(region.angle_rad)])
    top_px = np.array(region.center_px) + region.side_px / 2 * up
    np.testing.assert_allclose(region.crop_from_image(top_px, crop_px), ((crop_px - 1) / 2, -0.5), atol=1e-6)


@pytest.mark.parametrize(
    ("vector_px", "angle_deg"), [((0.0, -2.0), 0.0), ((3.0, 0.0), 90.0), ((-1.0, 0.0), -90.0), ((1.0, -1.0), 45.0)]
)
def test_upward_axis_turns_clockwise(vector_px: tuple[float, float], angle_deg: float) -> None:
    assert np.degrees(upward(np.array(vector_px))) == pytest.approx(angle_deg)


# Sides below, at and above the size at which blocks of pixels are averaged; a region beyond the border.
@pytest.mark.parametrize("side_px", [120.0, 256.0, 511.0, 512.0, 777.7, 1300.0])
@pytest.mark.parametrize("angle_deg", [0.0, 37.0, -160.0])
@pytest.mark.parametrize("center_px", [(400.3, 300.8), (60.0, 50.0)])
def test_point_in_crop_maps_back_to_its_place_in_image(
    side_px: float, angle_deg: float, center_px: tuple[float, float]
) -> None:
    region = Region(center_px, side_px, np.radians(angle_deg))
    spot_px = np.array(center_px) + side_px * np.array((0.11, 0.05))
    image = draw_blob((1000, 800), spot_px, 0.02 * side_px)
    sampled = crop(image, region, 256)
    assert sampled.shape == (1, 3, 256, 256)
    found_px = region.image_from_crop(centroid_px(sampled), 256)
    # Within 0.05 pixels of the crop: half a pixel of the crop or of the image would be far more.
    np.testing.assert_allclose(found_px, spot_px, atol=0.05 * side_px / 256)


def test_upright_region_of_crops_own_size_is_copy() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 80, 3), np.uint8)
    sampled = crop(image, Region((19.5, 25.5), 32.0), 32)
    np.testing.assert_allclose(sampled[0].transpose(1, 2, 0), image[10:42, 4:36] / np.float32(255), atol=1e-6)


def test_border_is_repeated_outside_of_image() -> None:
    image = np.full((40, 40, 3), (51, 102, 204), np.uint8)
    sampled = crop(image, Region((0.0, 0.0), 500.0, 0.3), 64)
    np.testing.assert_allclose(
        sampled, np.broadcast_to(np.array([0.2, 0.4, 0.8])[:, None, None], (1, 3, 64, 64)), atol=1e-6
    )


def test_crop_beside_image_repeats_its_border() -> None:
    image = np.full((40, 40, 3), 255, np.uint8)
    assert crop(image, Region((5000.0, -900.0), 800.0), 64).min() == 1.0


def test_large_regions_are_averaged_before_they_are_sampled() -> None:
    rows, columns = np.indices((600, 600))
    board = np.repeat(((rows + columns) % 2 * 255).astype(np.uint8)[..., None], 3, axis=2)
    sampled = crop(board, Region((299.5, 299.5), 512.0), 128)
    np.testing.assert_allclose(sampled, 0.5, atol=0.01)
