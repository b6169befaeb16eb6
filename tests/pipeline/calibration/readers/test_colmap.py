"""COLMAP's text model, with the comments and the lines of points that COLMAP writes."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, problems_of

CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 2
"""
IMAGES = """# Image list with two lines of data per image:
#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
#   POINTS2D[] as (X, Y, POINT3D_ID)
# Number of images: 2, mean observations per image: 1
"""
# 4 coefficients: the model OPENCV has no k3.
COLMAP_RIG = tuple(replace(one, distortion=one.distortion[:4]) for one in RIG)


def line_of_camera(number: int, one: Camera) -> str:
    (fx, _, cx), (_, fy, cy), _ = one.matrix.tolist()
    parameters = [fx, fy, cx + 0.5, cy + 0.5, *one.distortion.tolist()]
    return f"{number} OPENCV 1920 1080 {' '.join(map(repr, parameters))}\n"


def lines_of_image(number: int, one: Camera, name: str, points: str) -> str:
    qx, qy, qz, qw = Rotation.from_matrix(one.cam_from_world.rotation).as_quat().tolist()
    numbers = [qw, qx, qy, qz, *one.cam_from_world.translation_m.tolist()]
    return f"{number} {' '.join(map(repr, numbers))} {number} {name}\n{points}\n"


def parts(cameras: tuple[Camera, ...] = COLMAP_RIG) -> tuple[str, str]:
    text = CAMERAS + "".join(line_of_camera(k + 1, one) for k, one in enumerate(cameras))
    points = ["", "2.5 3.5 -1 100.25 200.0 7"]
    images = "".join(lines_of_image(k + 1, one, f"{one.name}.png", points[k % 2]) for k, one in enumerate(cameras))
    return text, IMAGES + images


def write_zip(path: Path, cameras: str, images: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("sparse/0/cameras.txt", cameras)
        archive.writestr("sparse/0/images.txt", images)
        archive.writestr("sparse/0/points3D.txt", "# none\n")
    return path


def test_zip_and_joined_file(tmp_path: Path) -> None:
    (tmp_path / "rig.txt").write_text("".join(parts()))
    for path in (write_zip(tmp_path / "rig.zip", *parts()), tmp_path / "rig.txt"):
        contents = read_contents(path)
        assert (contents.format, contents.unit) == ("COLMAP text", None)
        assert "arbitrary" in contents.axes
        assert_rig(contents, COLMAP_RIG)


def test_images_in_folders_have_folders_names(tmp_path: Path) -> None:
    cameras, _ = parts()
    images = IMAGES + "".join(
        lines_of_image(k + 1, one, f"{one.name}/00 01.png", "") for k, one in enumerate(COLMAP_RIG)
    )
    assert_rig(read_contents(write_zip(tmp_path / "rig.zip", cameras, images)), COLMAP_RIG)


@pytest.mark.parametrize(
    ("line", "distortion", "focal_px"),
    [
        ("SIMPLE_PINHOLE 1920 1080 1400 960 540", (), (1400, 1400)),
        ("PINHOLE 1920 1080 1400 1410 960 540", (), (1400, 1410)),
        ("SIMPLE_RADIAL 1920 1080 1400 960 540 -0.1", (-0.1, 0, 0, 0), (1400, 1400)),
        ("RADIAL 1920 1080 1400 960 540 -0.1 0.2", (-0.1, 0.2, 0, 0), (1400, 1400)),
        ("SIMPLE_FISHEYE 1920 1080 1400 960 540", (0, 0, 0, 0), (1400, 1400)),
        ("FISHEYE 1920 1080 1400 1410 960 540", (0, 0, 0, 0), (1400, 1410)),
        ("SIMPLE_RADIAL_FISHEYE 1920 1080 1400 960 540 -0.1", (-0.1, 0, 0, 0), (1400, 1400)),
        ("RADIAL_FISHEYE 1920 1080 1400 960 540 -0.1 0.2", (-0.1, 0.2, 0, 0), (1400, 1400)),
        ("OPENCV_FISHEYE 1920 1080 1400 1410 960 540 1 2 3 4", (1, 2, 3, 4), (1400, 1410)),
        ("FULL_OPENCV 1920 1080 1400 1410 960 540 1 2 3 4 5 6 7 8", (1, 2, 3, 4, 5, 6, 7, 8), (1400, 1410)),
    ],
)
def test_lens_models(tmp_path: Path, line: str, distortion: tuple[float, ...], focal_px: tuple[float, float]) -> None:
    cameras = f"{CAMERAS}1 {line}\n2 {line}\n"
    one, _ = read_contents(write_zip(tmp_path / "rig.zip", cameras, parts()[1])).cameras
    assert one.lens == ("fisheye" if "FISHEYE" in line else "standard")
    np.testing.assert_array_equal(one.distortion, distortion)
    np.testing.assert_array_equal(one.matrix, [[focal_px[0], 0, 959.5], [0, focal_px[1], 539.5], [0, 0, 1]])


@pytest.mark.parametrize("model", ["FOV", "THIN_PRISM_FISHEYE", "nonsense"])
def test_other_lens_models_are_refused_by_name(tmp_path: Path, model: str) -> None:
    cameras = parts()[0].replace("2 OPENCV", f"2 {model}")
    path = write_zip(tmp_path / "rig.zip", cameras, parts()[1])
    assert problems_of(path) == [("unsupported_lens", "right")]
    with pytest.raises(InputError, match=model):
        read_contents(path)


@pytest.mark.parametrize(
    ("cameras", "images"),
    [
        (CAMERAS, parts()[1]),
        (parts()[0].replace("1920", "wide"), parts()[1]),
        (parts()[0].replace("1450.0", ""), parts()[1]),
        (parts()[0], IMAGES + "1 0 0 0 0 1 2 3 1 left.png\n\n"),
        (parts()[0], IMAGES + "1 nan 0 0 1 1 2 3 1 left.png\n\n"),
        (parts()[0], IMAGES + "1 0 0 0 1 1 2\n"),
    ],
)
def test_malformed_lines(tmp_path: Path, cameras: str, images: str) -> None:
    with pytest.raises(InputError) as error:
        read_contents(write_zip(tmp_path / "rig.zip", cameras, images))
    assert {problem.code for problem in error.value.problems} == {"calibration_unreadable"}


def test_two_images_of_one_camera(tmp_path: Path) -> None:
    images = parts()[1].replace("right.png", "left.png")
    assert problems_of(write_zip(tmp_path / "rig.zip", parts()[0], images)) == [("duplicate_camera", "left")]


@given(place=st.integers(0, 900), noise=st.text("0123456789 .-\n#e", min_size=1, max_size=6))
def test_damaged_files_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, place: int, noise: str) -> None:
    text = "".join(parts())
    path = tmp_path_factory.getbasetemp() / "damaged.txt"
    path.write_text(text[:place] + noise + text[place + len(noise) :])
    try:
        contents = read_contents(path)
    except InputError:
        return
    assert all(np.isfinite(one.matrix).all() for one in contents.cameras)
