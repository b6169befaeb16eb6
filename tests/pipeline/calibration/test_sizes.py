"""Cameras adapted to another picture size: a world point is seen at the same place of the scene's picture."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.sizes import fit_to_picture, fit_to_video
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.geometry.camera import project

POINTS_M = np.array([[0.0, 0.0, 0.0], [0.7, -0.4, 0.2], [-0.6, 0.5, -0.3]])


def camera(size_px: tuple[int, int], distortion: Any = (), skew_px: float = 0.0) -> Camera:
    matrix = np.array([[1700.0, skew_px, 533.0], [0.0, 1690.0, 948.0], [0.0, 0.0, 1.0]])
    pose = Rigid3(Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix(), np.array([0.1, 0.2, 4.0]))
    return Camera("cam", size_px, matrix, np.array(distortion, dtype=float), pose, "section")


def fitted(calibrated: Camera, size_px: tuple[int, int], rotation_deg: int) -> Camera:
    found = fit_to_picture(calibrated, size_px, rotation_deg)
    assert found is not None
    assert found[0].size_px == size_px
    assert (found[0].name, found[0].section) == ("cam", "section")
    return found[0]


@pytest.mark.parametrize(
    ("calibrated_px", "shown_px", "rotation_deg", "moved_px"),
    [
        ((1088, 1920), (1080, 1920), 0, (0, 0)),
        ((1920, 1080), (1920, 1088), 0, (0, 0)),
        ((1920, 1088), (1920, 1080), 90, (0, -8)),
        ((1088, 1920), (1080, 1920), 90, (0, 0)),
        ((1920, 1080), (1920, 1088), 180, (0, 8)),
        ((1088, 1920), (1080, 1920), 270, (-8, 0)),
        ((1920, 1088), (1920, 1080), 270, (0, 0)),
        ((1001, 562), (1008, 562), 0, (0, 0)),
    ],
)
def test_padding_is_at_right_and_bottom_of_stored_picture(
    calibrated_px: tuple[int, int], shown_px: tuple[int, int], rotation_deg: int, moved_px: tuple[int, int]
) -> None:
    before = camera(calibrated_px, (-0.1, 0.05, 0.001, -0.002))
    after = fitted(before, shown_px, rotation_deg)
    np.testing.assert_allclose(project(after, POINTS_M), project(before, POINTS_M) + np.array(moved_px), atol=1e-9)


@pytest.mark.parametrize(
    ("calibrated_px", "shown_px", "rotation_deg", "moved_px"),
    [
        ((1088, 1920), (1080, 1920), 0, (-8, 0)),
        ((1920, 1080), (1920, 1088), 0, (0, 0)),
        ((1920, 1088), (1920, 1080), 90, (0, 0)),
        ((1088, 1920), (1080, 1920), 90, (0, 0)),
        ((1920, 1080), (1920, 1088), 180, (0, 8)),
        ((1088, 1920), (1080, 1920), 180, (0, 0)),
        ((1920, 1088), (1920, 1080), 270, (0, -8)),
        ((1088, 1920), (1080, 1920), 270, (-8, 0)),
    ],
)
def test_padding_of_mirrored_picture_is_at_other_side(
    calibrated_px: tuple[int, int], shown_px: tuple[int, int], rotation_deg: int, moved_px: tuple[int, int]
) -> None:
    before = camera(calibrated_px, (-0.1, 0.05, 0.001, -0.002))
    found = fit_to_picture(before, shown_px, rotation_deg, is_mirrored=True)
    assert found is not None
    np.testing.assert_allclose(project(found[0], POINTS_M), project(before, POINTS_M) + np.array(moved_px), atol=1e-9)


def test_camera_of_stored_picture_rejects_mirrored_one() -> None:
    assert fit_to_picture(camera((1920, 1080)), (1080, 1920), 90) is not None
    assert fit_to_picture(camera((1920, 1080)), (1080, 1920), 90, is_mirrored=True) is None


@pytest.mark.parametrize("off_px", [1, -1])
@pytest.mark.parametrize("size_px", [(1920, 1080), (1000, 1000)])
def test_sides_that_are_counted_one_pixel_off_leave_matrix(size_px: tuple[int, int], off_px: int) -> None:
    width, height = size_px
    before = camera((width + off_px, height + off_px), (-0.1, 0.05, 0.001, -0.002))
    np.testing.assert_array_equal(project(fitted(before, size_px, 0), POINTS_M), project(before, POINTS_M))
    if width != height:
        assert fit_to_picture(camera((width + off_px, height - off_px)), size_px, 0) is None


def test_padding_is_said_by_side_and_number() -> None:
    for shown_px, rotation_deg, words in (
        ((1080, 1920), 0, "8 columns at the right"),
        ((1080, 1920), 270, "8 columns at the left"),
    ):
        found = fit_to_picture(camera((1088, 1920)), shown_px, rotation_deg)
        assert found is not None
        assert found[1].startswith(words)
    found = fit_to_picture(camera((1920, 1080)), (1920, 1088), 90)
    assert found is not None
    assert found[1].startswith("8 rows at the top")


@given(factor=st.sampled_from([0.25, 0.5, 2 / 3, 4 / 3, 2.0]), skew_px=st.floats(-5.0, 5.0))
def test_scaled_pictures_share_their_outer_edges(factor: float, skew_px: float) -> None:
    before = camera((1920, 1080), (-0.1, 0.05, 0.001, -0.002, 0.01), skew_px)
    after = fitted(before, (round(1920 * factor), round(1080 * factor)), 0)
    np.testing.assert_allclose(
        project(after, POINTS_M) + 0.5, factor * (project(before, POINTS_M) + 0.5), rtol=0, atol=1e-8
    )


@pytest.mark.parametrize("num_coefficients", [0, 4, 5, 8, 12])
@pytest.mark.parametrize("rotation_deg", [90, 270])
def test_quarter_turn_turns_pixels(num_coefficients: int, rotation_deg: int) -> None:
    before = camera((1920, 1080), 0.02 * np.arange(1, num_coefficients + 1) * (-1) ** np.arange(num_coefficients))
    after = fitted(before, (1080, 1920), rotation_deg)
    x, y = project(before, POINTS_M).T
    # The file says counterclockwise: 90 degrees bring the picture's right edge to the top.
    expected = np.column_stack([y, 1919 - x] if rotation_deg == 90 else [1079 - y, x])
    np.testing.assert_allclose(project(after, POINTS_M), expected, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(after.cam_from_world.rotation), 1.0)


@pytest.mark.parametrize(
    ("calibrated_px", "shown_px", "rotation_deg"),
    [
        ((1920, 1080), (1080, 1920), 0),  # either quarter turn is possible
        ((1920, 1080), (1080, 1920), 180),
        ((1920, 1080), (1440, 1080), 0),
        ((1920, 1080), (1920, 1096), 0),  # 16 rows are a block of their own
        ((1920, 1080), (1920, 1084), 0),  # not whole blocks
        ((1920, 1080), (1928, 1088), 0),  # both sides
        ((1920, 1080), (1280, 721), 0),
        ((1920, 1088), (960, 540), 0),
    ],
)
def test_other_sizes_do_not_fit(calibrated_px: tuple[int, int], shown_px: tuple[int, int], rotation_deg: int) -> None:
    assert fit_to_picture(camera(calibrated_px), shown_px, rotation_deg) is None


def test_skewed_camera_is_not_turned() -> None:
    assert fit_to_picture(camera((1920, 1080), skew_px=1.0), (1080, 1920), 90) is None


@pytest.mark.parametrize(("size_px", "fits"), [((1080, 1920), True), ((1920, 1080), False), ((540, 960), False)])
def test_unknown_size_is_videos_if_principal_point_is_central(size_px: tuple[int, int], fits: bool) -> None:
    before = camera(UNKNOWN_SIZE)
    found = fit_to_picture(before, size_px, 0)
    assert (found is not None) == fits
    if found is not None:
        assert found[0].size_px == size_px
        np.testing.assert_array_equal(found[0].matrix, before.matrix)


@pytest.mark.parametrize(
    ("calibrated_px", "rotation_deg", "factors"),
    [
        ((1440, 1080), 0, (4 / 3, 1.0)),
        ((720, 540), 0, (8 / 3, 2.0)),
        ((1440, 1088), 180, (4 / 3, 1.0)),
        ((1080, 1440), 90, (1.0, 4 / 3)),
    ],
)
def test_calibration_of_stored_pixels_is_stretched_as_they_are(
    calibrated_px: tuple[int, int], rotation_deg: int, factors: tuple[float, float]
) -> None:
    before = camera(calibrated_px, (-0.1, 0.05, 0.001, -0.002))
    shown_px = (1920, 1080) if rotation_deg % 180 == 0 else (1080, 1920)
    found = fit_to_video(before, shown_px, rotation_deg, (1440, 1080))
    assert found is not None
    assert "not square" in found[1]
    assert found[0].size_px == shown_px
    # A picture turned by 180 degrees has its padding of 8 rows at the top.
    padded = np.array([0.0, 8.0 if calibrated_px[1] == 1088 else 0.0])
    expected = (project(before, POINTS_M) - padded + 0.5) * np.array(factors) - 0.5
    np.testing.assert_allclose(project(found[0], POINTS_M), expected, atol=1e-9)


def test_calibration_of_shown_picture_is_taken_as_it_is() -> None:
    calibrated = camera((1920, 1080))
    assert fit_to_video(calibrated, (1920, 1080), 0, (1440, 1080)) == (calibrated, "")
    found = fit_to_video(camera((960, 540)), (1920, 1080), 0, (1440, 1080))
    assert found is not None
    assert found[1] == "the calibration is scaled by 2"
    assert fit_to_video(camera((1000, 1080)), (1920, 1080), 0, (1440, 1080)) is None


@pytest.mark.parametrize(("focal_px", "is_stretched"), [((1500.0, 1505.0), False), ((1130.0, 1500.0), True)])
def test_focal_lengths_tell_pixels_of_calibration_without_size(
    focal_px: tuple[float, float], is_stretched: bool
) -> None:
    matrix = np.array([[focal_px[0], 0.0, 719.5], [0.0, focal_px[1], 539.5], [0.0, 0.0, 1.0]])
    pose = Rigid3(np.eye(3), np.array([0.0, 0.0, 3.0]))
    found = fit_to_video(Camera("cam", UNKNOWN_SIZE, matrix, np.zeros(5), pose), (1920, 1080), 0, (1440, 1080))
    assert found is not None
    assert found[0].size_px == (1920, 1080)
    assert found[0].matrix[0, 0] == pytest.approx(focal_px[0] * (4 / 3 if is_stretched else 1))
