import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.detection.letterbox import LetterBox, apply_letterbox, fit_letterbox

SIZES = [(1920, 1080), (1088, 1920), (640, 480), (333, 517), (1279, 719), (97, 41), (512, 512)]


def test_long_side_is_scaled_and_rest_padded() -> None:
    assert fit_letterbox((1920, 1080), 512 / 1920, 32) == LetterBox((1920, 1080), (512, 288), (512, 288))
    assert fit_letterbox((1088, 1920), 512 / 1920, 32) == LetterBox((1088, 1920), (290, 512), (320, 512))
    assert fit_letterbox((64, 48), 512 / 64, 32) == LetterBox((64, 48), (512, 384), (512, 384))
    assert fit_letterbox((10_000, 3), 512 / 10_000, 32) == LetterBox((10_000, 3), (512, 1), (512, 32))


@given(
    size=st.tuples(st.integers(1, 8000), st.integers(1, 8000)),
    long_side=st.integers(32, 1024),
    multiple=st.sampled_from([1, 8, 32]),
)
def test_both_ways_are_inverse_and_corners_meet(size: tuple[int, int], long_side: int, multiple: int) -> None:
    letterbox = fit_letterbox(size, long_side / max(size), multiple)
    assert max(letterbox.scaled_size_px) == long_side
    assert all(side % multiple == 0 for side in letterbox.padded_size_px)
    assert all(
        0 <= padded - scaled < multiple
        for padded, scaled in zip(letterbox.padded_size_px, letterbox.scaled_size_px, strict=True)
    )
    # The corners of the first and the last pixel, not their centres, are what a resampled image keeps.
    corners_px = np.array([[0, 0], size]) - 0.5
    in_network_px = letterbox.network_from_image(corners_px)
    expected_px = np.array([[0, 0], letterbox.scaled_size_px]) - 0.5
    np.testing.assert_allclose(in_network_px, expected_px, atol=1e-9)
    np.testing.assert_allclose(letterbox.image_from_network(in_network_px), corners_px, atol=1e-9)


@given(
    size=st.tuples(st.integers(1, 8000), st.integers(1, 8000)),
    long_side=st.integers(32, 1024),
    turn_deg=st.one_of(st.floats(-360.0, 360.0), st.sampled_from([90.0, 180.0, 270.0])),
    share=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_turned_images_map_there_and_back_and_lie_inside(
    size: tuple[int, int], long_side: int, turn_deg: float, share: tuple[float, float]
) -> None:
    letterbox = fit_letterbox(size, long_side / max(size), 32, turn_deg)
    point_px = np.array(share) * size - 0.5
    in_network_px = letterbox.network_from_image(point_px)
    np.testing.assert_allclose(letterbox.image_from_network(in_network_px), point_px, atol=1e-8)
    # Turned images are inside of the scaled part, which rounding makes narrower by half a pixel at most.
    slack = 1e-6 * long_side + 1e-6
    assert (in_network_px >= -0.5 - slack).all()
    assert (in_network_px <= np.array(letterbox.scaled_size_px) - 0.5 + slack).all()


def test_quarter_turn_to_left_brings_right_edge_up() -> None:
    letterbox = fit_letterbox((1920, 1080), 512 / 1920, 32, 90.0)
    assert letterbox == LetterBox((1920, 1080), (288, 512), (288, 512), 90.0)
    corners_px = np.array([(1919.5, -0.5), (1919.5, 1079.5), (-0.5, -0.5)])
    np.testing.assert_allclose(letterbox.network_from_image(corners_px), [(-0.5, -0.5), (287.5, -0.5), (-0.5, 511.5)])
    image = np.zeros((1080, 1920, 3), np.uint8)
    image[:40, -60:] = 200
    small = apply_letterbox(image, letterbox)
    assert (small[:14, :9] > 190).all()
    assert not small[20:].any()


@pytest.mark.parametrize("turn_deg", [90.0, 180.0, 270.0])
@pytest.mark.parametrize("size", SIZES)
def test_hanging_camera_gives_input_of_upright_one(size: tuple[int, int], turn_deg: float) -> None:
    upright = np.random.default_rng(3).integers(0, 256, (size[1], size[0], 3), np.uint8)
    hanging = np.ascontiguousarray(np.rot90(upright, -round(turn_deg / 90)))
    size_px = hanging.shape[1], hanging.shape[0]
    expected = apply_letterbox(upright, fit_letterbox(size, 512 / max(size), 32))
    found = apply_letterbox(hanging, fit_letterbox(size_px, 512 / max(size), 32, turn_deg))
    np.testing.assert_array_equal(found, expected)


def test_nan_stays_nan() -> None:
    letterbox = fit_letterbox((100, 50), 512 / 100, 32)
    assert np.isnan(letterbox.image_from_network(np.array([np.nan, 3.0]))).tolist() == [True, False]


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0, 33.0, 137.0])
@pytest.mark.parametrize("size", SIZES)
def test_resampled_picture_follows_mapping(size: tuple[int, int], turn_deg: float) -> None:
    width, height = size
    center_px = np.array([0.37 * width + 0.21, 0.61 * height - 0.17])
    letterbox = fit_letterbox(size, 512 / max(size), 32, turn_deg)
    sigma_px = 4 / letterbox.scale.min()
    squared_px = (np.arange(width) - center_px[0]) ** 2 + ((np.arange(height) - center_px[1]) ** 2)[:, None]
    blob = np.repeat((255 * np.exp(-squared_px / (2 * sigma_px**2))).round().astype(np.uint8)[..., None], 3, axis=2)
    padded = apply_letterbox(blob, letterbox)[..., 1].astype(float)
    assert padded.shape == letterbox.padded_size_px[::-1]
    found_px = np.array([np.arange(padded.shape[1]) @ padded.sum(0), np.arange(padded.shape[0]) @ padded.sum(1)])
    found_px /= padded.sum()
    # In pixels of the network; a forgotten half pixel is 0.15 to 0.5 of them, or more where the image is magnified.
    np.testing.assert_allclose(found_px, letterbox.network_from_image(center_px), atol=0.02)


def test_padding_is_black_and_colours_keep_their_order() -> None:
    image = np.full((30, 100, 3), (10, 20, 30), np.uint8)
    padded = apply_letterbox(image, fit_letterbox((100, 30), 512 / 100, 32))
    assert padded.shape == (160, 512, 3)
    assert (padded[:154] == (10, 20, 30)).all()
    assert (padded[154:] == 0).all()
