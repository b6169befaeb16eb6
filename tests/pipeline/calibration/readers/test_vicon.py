"""Vicon's XCP with the old and the new attribute of the lens, in the form that Nexus writes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project
from pipeline.geometry.undistortion import undistort_px
from tests.pipeline.calibration.readers.rigs import POINTS_M, RIG, problems_of

RADIAL = (2.4e-8, -1.7e-15, 3e-22)
# A lens that shows the corners of the picture at 0.6 of the ideal radius.
WIDE = (2.6e-7, 4.1e-14, 8.9e-20)


def element(one: Camera, lens: str, kind: str = "FLIR.Video", system: str = "MX") -> str:
    quaternion = Rotation.from_matrix(one.cam_from_world.rotation).as_quat().tolist()
    centre_mm = (1000.0 * center_in_world(one)).tolist()
    return f"""<Camera DEVICEID="{one.name}" DISPLAY_TYPE="Vue" NAME="Vue {one.name}" PIXEL_ASPECT_RATIO="{1450 / 1460}"
 SENSOR_SIZE="1920 1080" SKEW="0" SYSTEM="{system}" TYPE="{kind}" USERID="1">
<ThresholdGrid BIT_DEPTH="1"/><ControlFrames/>
<KeyFrames><KeyFrame FOCAL_LENGTH="1450" FRAME="0" IMAGE_ERROR="0.2" ORIENTATION="{" ".join(map(repr, quaternion))}"
 POSITION="{" ".join(map(repr, centre_mm))}" PRINCIPAL_POINT="951.5 548.25" {lens} WORLD_ERROR="0.3"/>
</KeyFrames></Camera>
"""


def write(path: Path, *elements: str) -> Path:
    path.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<Cameras NAME="" VERSION="1.0">{"".join(elements)}</Cameras>'
    )
    return path


def ideal_from_seen(seen_px: np.ndarray, centre_px: np.ndarray, radial: tuple[float, ...]) -> np.ndarray:
    """Vicon's own model."""
    offset_px = seen_px - centre_px
    r2 = (offset_px**2).sum(-1, keepdims=True)
    return centre_px + offset_px * (1 + sum(k * r2 ** (n + 1) for n, k in enumerate(radial)))


@pytest.mark.parametrize(
    ("lens", "centre_px", "radial"),
    [
        ('VICON_RADIAL="0 0"', (951.5, 548.25), ()),
        (f'VICON_RADIAL="{RADIAL[0]} {RADIAL[1]}"', (951.5, 548.25), RADIAL[:2]),
        (f'VICON_RADIAL2="Vicon3Parameter 951.5 548.25 {RADIAL[0]} {RADIAL[1]} {RADIAL[2]}"', (951.5, 548.25), RADIAL),
        (f'VICON_RADIAL="9 9" VICON_RADIAL2="Vicon3Parameter 955 546 {RADIAL[0]} 0 0"', (955.0, 546.0), RADIAL[:1]),
    ],
)
def test_points_are_seen_where_vicon_sees_them(
    tmp_path: Path, lens: str, centre_px: tuple[float, float], radial: tuple[float, ...]
) -> None:
    path = write(
        tmp_path / "session.xcp", element(RIG[0], lens), element(RIG[1], lens), element(RIG[0], "", "DxCore160")
    )
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("Vicon XCP", "mm")
    assert [(one.name, one.section) for one in contents.cameras] == [("left", "Vue left"), ("right", "Vue right")]
    for found, expected in zip(contents.cameras, RIG, strict=True):
        assert found.size_px == (1920, 1080)
        ideal_px = project(replace(expected, distortion=np.empty(0)), POINTS_M)
        np.testing.assert_allclose(
            ideal_from_seen(project(found, POINTS_M), np.array(centre_px), radial), ideal_px, atol=0.03
        )
    if radial:
        assert np.abs(project(contents.cameras[1], POINTS_M) - ideal_px).max() > 0.4


def test_wide_lens_in_whole_picture(tmp_path: Path) -> None:
    lens = f'VICON_RADIAL2="Vicon3Parameter 951.5 548.25 {WIDE[0]} {WIDE[1]} {WIDE[2]}"'
    square = [element(camera, lens).replace(str(1450 / 1460), "1") for camera in RIG]
    contents = read_contents(write(tmp_path / "session.xcp", *square))
    seen_px = np.stack(np.meshgrid(np.linspace(0, 1919, 49), np.linspace(0, 1079, 31)), -1).reshape(-1, 2)
    for camera in contents.cameras:
        assert len(camera.distortion) == 8
        ideal_px = ideal_from_seen(seen_px, np.array([951.5, 548.25]), WIDE)
        assert np.abs(ideal_px - seen_px).max() > 400
        np.testing.assert_allclose(undistort_px(camera, seen_px), ideal_px, atol=0.6)


def test_video_cameras_of_other_makers(tmp_path: Path) -> None:
    video, marker = element(RIG[0], "", "Blackfly", "DV"), element(RIG[1], "", "Vantage16V")
    contents = read_contents(write(tmp_path / "session.xcp", video, marker))
    assert [camera.name for camera in contents.cameras] == ["left"]
    assert "camera right is left out: markers, no video" in contents.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "problems"),
    [
        ('FOCAL_LENGTH="1450"', "", [("invalid_number", "left")]),
        ('FOCAL_LENGTH="1450"', 'FOCAL_LENGTH="-1"', [("invalid_number", "left")]),
        ('PRINCIPAL_POINT="951.5 548.25"', 'PRINCIPAL_POINT="951.5"', [("invalid_number", "left")]),
        ('SENSOR_SIZE="1920 1080"', 'SENSOR_SIZE="nan 1080"', [("invalid_number", "left")]),
        ('VICON_RADIAL="0 0"', 'VICON_RADIAL="1 0"', [("unsupported_lens", "left")]),
        ('VICON_RADIAL="0 0"', 'VICON_RADIAL="-5e-7 0"', [("unsupported_lens", "left")]),
        ('VICON_RADIAL="0 0"', 'VICON_RADIAL2="Fisheye 1 2 3"', [("unsupported_lens", "left")]),
    ],
)
def test_faults(tmp_path: Path, old: str, new: str, problems: list[tuple[str, str]]) -> None:
    lens = 'VICON_RADIAL="0 0"'
    first = element(RIG[0], lens)
    assert old in first
    assert problems_of(write(tmp_path / "session.xcp", first.replace(old, new), element(RIG[1], lens))) == problems


def test_orientation_of_zeros(tmp_path: Path) -> None:
    zeros = element(RIG[0], "").replace('ORIENTATION="', 'ORIENTATION="0 0 0 0" WAS="')
    path = write(tmp_path / "session.xcp", zeros, element(RIG[1], ""))
    assert problems_of(path) == [("invalid_rotation", "left")]


def test_no_camera_and_no_xml(tmp_path: Path) -> None:
    assert problems_of(write(tmp_path / "none.xcp")) == [("calibration_empty", None)]
    (tmp_path / "cut.xcp").write_text("<Cameras><Camera")
    assert problems_of(tmp_path / "cut.xcp") == [("calibration_unreadable", None)]
