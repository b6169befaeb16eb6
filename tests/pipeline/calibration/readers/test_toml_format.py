"""TOML of anipose, Pose2Sim and FreeMoCap, as each program writes it."""

from dataclasses import replace
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.registry import read_contents
from pipeline.data.cameras import Camera
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, fisheye, problems_of


def section(title: str, one: Camera, unit_per_m: float, more: str = "") -> str:
    pose = one.cam_from_world
    return f"""
[{title}]
name = "{one.name}"
size = [ {one.size_px[0]}, {one.size_px[1]},]
matrix = {one.matrix.tolist()}
distortions = {one.distortion.tolist()}
rotation = {Rotation.from_matrix(pose.rotation).as_rotvec().tolist()}
translation = {(unit_per_m * pose.translation_m).tolist()}
{more}
"""


def write(path: Path, unit_per_m: float, metadata: str, rig: tuple[Camera, ...] = RIG, more: str = "") -> Path:
    sections = "".join(section(f"cam_{k}", one, unit_per_m, more) for k, one in enumerate(rig))
    path.write_text(f"{sections}\n[metadata]\n{metadata}\n")
    return path


def test_anipose(tmp_path: Path) -> None:
    path = write(tmp_path / "calibration.toml", 1000.0, "adjusted = false\nerror = 0.85")
    contents = read_contents(path, "mm")
    assert (contents.format, contents.unit) == ("TOML", None)
    assert_rig(contents)


def test_pose2sim(tmp_path: Path) -> None:
    """Sizes are floats, there are 4 coefficients, and ``fisheye`` is written."""
    rig = tuple(replace(one, distortion=one.distortion[:4]) for one in RIG)
    path = write(tmp_path / "Calib.toml", 1.0, "adjusted = false\nerror = 0.0", rig, "fisheye = false")
    path.write_text(path.read_text().replace("[ 1920, 1080,]", "[ 1920.0, 1080.0]"))
    assert_rig(read_contents(path), rig)


def test_fisheye(tmp_path: Path) -> None:
    rig = (fisheye("left", 0.3), fisheye("right", -0.8))
    path = write(tmp_path / "calibration.toml", 1.0, "adjusted = true\nerror = 0.3", rig, "fisheye = true")
    assert_rig(read_contents(path), rig)


def caliscope(number: int, one: Camera, more: str = "") -> str:
    """Section of ``camera_array.toml``; missing values are left out, or the text "null"."""
    return section(f"cameras.{number}", one, 1.0, more).replace(
        f'name = "{one.name}"',
        f'cam_id = {number}\nrotation_count = 0\nerror = 0.31\ngrid_count = 25\nexposure = "null"',
    )


def test_caliscope_knows_cameras_by_their_numbers(tmp_path: Path) -> None:
    path = tmp_path / "camera_array.toml"
    unposed = '\n[cameras.7]\ncam_id = 7\nsize = [1920, 1080]\nrotation = "null"\ntranslation = "null"\n'
    ignored = caliscope(8, RIG[0], "ignore = true")
    path.write_text(caliscope(0, RIG[0]) + caliscope(2, fisheye("right", -0.8), "fisheye = true") + unposed + ignored)
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("Caliscope", None)
    assert contents.notes == ("2 cameras of camera_array.toml are left out: they are ignored or have no pose.",)
    assert_rig(contents, (replace(RIG[0], name="cam_0"), fisheye("cam_2", -0.8)))
    assert [one.section for one in contents.cameras] == ["port_0", "port_2"]


@pytest.mark.parametrize("content", ["[cameras]\n", "[cameras.0]\nsize=[6,4]\n", "cameras = 5\n"])
def test_files_without_a_posed_camera_are_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "camera_array.toml"
    path.write_text(content)
    assert problems_of(path)


FREEMOCAP = """adjusted = false
error = 0.0
charuco_square_size = 39
charuco_board_object = "CharucoBoardDefinition"
path_to_recorded_videos = "recordings"
date_time_calibrated = "2024-01-01"
groundplane_calibration = true"""


def test_freemocap_is_in_millimetres(tmp_path: Path) -> None:
    more = "world_position = [ 1.0, 2.0, 3.0,]\nworld_orientation = [ [ 1.0, 0.0, 0.0,],]"
    path = write(tmp_path / "camera_calibration.toml", 1000.0, FREEMOCAP, more=more)
    for units in ("m", "mm"):
        contents = read_contents(path, units)
        assert (contents.format, contents.unit) == ("FreeMoCap TOML", "mm")
        assert_rig(contents)
    assert problems_of(path, "cm") == [("calibration_units", None)]


@pytest.mark.parametrize("square", ["1", "1.0", "true", "'wide'"])
def test_freemocap_without_the_size_of_the_board(tmp_path: Path, square: str) -> None:
    metadata = FREEMOCAP.replace("= 39", f"= {square}")
    assert read_contents(write(tmp_path / "rig.toml", 1.0, metadata)).unit is None
