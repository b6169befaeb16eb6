"""TOML of Caliscope, anipose, Pose2Sim and FreeMoCap, as each program writes it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.geometry.camera import center_in_world
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


def test_vectors_as_columns_and_rows(tmp_path: Path) -> None:
    """Versions of Pose2Sim wrote columns."""
    path = write(tmp_path / "calibration.toml", 1.0, "adjusted = false")
    text = re.sub(r"(rotation|translation) = \[(.*), (.*), (.*)\]", r"\1 = [[\2], [\3], [\4]]", path.read_text())
    path.write_text(re.sub(r"distortions = (.*)", r"distortions = [\1]", text))
    assert_rig(read_contents(path, "m"))


def test_anipose_in_millimetres_is_asked_for_its_unit(tmp_path: Path) -> None:
    path = write(tmp_path / "calibration.toml", 1000.0, "adjusted = false\nerror = 0.85")
    with pytest.raises(InputError) as error:
        read_contents(path)
    (problem,) = error.value.problems
    assert problem.code == "calibration_units_unstated"
    # Both cameras are 4.37 m from the origin.
    assert problem.message == (
        "The file does not state the unit of its lengths: camera left is 4.4 m if they are millimetres, or 4,369 m if "
        "they are metres, from the origin."
    )
    assert "--units mm" in str(problem)
    far = read_contents(path, "m").cameras[0]
    assert np.linalg.norm(center_in_world(far)) == pytest.approx(4369.2, abs=0.1)


def test_unknown_fields_are_noted(tmp_path: Path) -> None:
    path = write(tmp_path / "calibration.toml", 1.0, "error = 0.3", more='shutter = "global"\ngain = 3')
    contents = read_contents(path)
    assert contents.notes == ("calibration.toml: fields that are not read: shutter, gain.",)
    assert_rig(contents)


def test_pose2sim(tmp_path: Path) -> None:
    """Sizes are floats, there are 4 coefficients, and ``fisheye`` is written."""
    rig = tuple(replace(one, distortion=one.distortion[:4]) for one in RIG)
    path = write(tmp_path / "Calib.toml", 1.0, "adjusted = false\nerror = 0.0", rig, "fisheye = false")
    path.write_text(path.read_text().replace("[ 1920, 1080,]", "[ 1920.0, 1080.0]"))
    assert_rig(read_contents(path), rig)


@pytest.mark.parametrize("parts", [64, 128])
def test_pose2sim_divides_lens_of_qualisys(tmp_path: Path, parts: int) -> None:
    """Numbers with the six decimals of Qualisys's file; the second part is for binned pixels."""
    rig = tuple(replace(one, distortion=np.array([-0.110853, 0.070001, 0.000607, 0.0])) for one in RIG)
    parted = tuple(replace(one, distortion=one.distortion / parts) for one in rig)
    path = write(tmp_path / "Calib_qualisys.toml", 1.0, "adjusted = false\nerror = 0.0", parted, "fisheye = false")
    assert_rig(read_contents(path), parted)
    path.write_text(path.read_text().replace("[ 1920, 1080,]", "[ 1920.0, 1080.0]"))
    contents = read_contents(path)
    assert_rig(contents, rig)
    assert f"divided the distortion of the Qualisys cameras by {parts}" in contents.notes[0]


def test_lens_in_section_beside_cameras_is_not_dropped(tmp_path: Path) -> None:
    path = write(tmp_path / "rig.toml", 1.0, "error = 0.3")
    path.write_text(path.read_text() + "\n[lens]\ncoeffs = [-0.1, 0.2, 0.0, 0.0]\n")
    assert problems_of(path) == [("unsupported_lens", None)]


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
    posed_never = caliscope(9, RIG[0]).replace("rotation = [", "# rotation = [")
    ignored = caliscope(8, RIG[0], "ignore = true")
    right = caliscope(2, fisheye("right", -0.8), "fisheye = true")
    path.write_text(caliscope(0, RIG[0]) + right + unposed + ignored + posed_never)
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("Caliscope", None)
    assert contents.notes == (
        "camera_array.toml: camera cam_8 is left out: ignored by the file.",
        "camera_array.toml: camera cam_7 is left out: no camera matrix in the file.",
        "camera_array.toml: camera cam_9 is left out: no pose in the file.",
    )
    assert_rig(contents, (replace(RIG[0], name="cam_0"), fisheye("cam_2", -0.8)))
    assert [one.section for one in contents.cameras] == ["port_0", "port_2"]


def matrices(text: str, rig: tuple[Camera, ...] = RIG) -> str:
    """The same file with rotations as matrices, as versions before 0.1 wrote them."""
    for camera in rig:
        rotation = camera.cam_from_world.rotation
        text = text.replace(str(Rotation.from_matrix(rotation).as_rotvec().tolist()), str(rotation.tolist()))
    return text


def test_caliscope_before_it_wrote_vectors(tmp_path: Path) -> None:
    path = tmp_path / "camera_array.toml"
    more = "verified_resolutions = [[640, 480], [1280, 720]]"
    path.write_text(matrices("".join(caliscope(k, one, more) for k, one in enumerate(RIG))))
    assert "rotation = [[" in path.read_text()
    contents = read_contents(path)
    assert contents.notes == ()
    assert_rig(contents, (replace(RIG[0], name="cam_0"), replace(RIG[1], name="cam_1")))


def test_caliscope_with_cameras_among_its_settings(tmp_path: Path) -> None:
    """``config.toml`` of the oldest versions."""
    path = tmp_path / "config.toml"
    settings = "CreationDate = 2023-03-31T09:56:43.193358\ncamera_count = 2\n"
    charuco = "\n[charuco]\ncolumns = 4\nrows = 5\nboard_height = 11.0\n"
    path.write_text(settings + matrices("".join(section(f"cam_{k}", one, 1.0) for k, one in enumerate(RIG))) + charuco)
    contents = read_contents(path)
    assert_rig(contents)
    assert contents.notes == ("config.toml: fields that are not read: CreationDate, camera_count, charuco.",)


@pytest.mark.parametrize("content", ["[cameras]\n", "[cameras.0]\nsize=[6,4]\n", "cameras = 5\n"])
def test_files_without_posed_camera_are_refused(tmp_path: Path, content: str) -> None:
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


FREEMOCAP_2 = """solver_method = "anipose"
reprojection_error_px = 0.41
groundplane_applied = true
[metadata.board]
squares_x = 7
squares_y = 5
square_length_mm = 58.0
marker_length_mm = 46.4"""


@pytest.mark.parametrize("identified", [True, False])
def test_freemocap_2_is_in_millimetres_by_its_board(tmp_path: Path, identified: bool) -> None:
    world = "world_position = [1.0, 2.0, 3.0]\nworld_orientation = [[1.0, 0.0, 0.0]]"
    path = tmp_path / "recording_camera_calibration.toml"
    write(path, 1000.0, FREEMOCAP_2, more=f'id = "a"\nindex = 0\n{world}' if identified else world)
    contents = read_contents(path)
    assert (contents.format, contents.unit, contents.notes) == ("FreeMoCap TOML", "mm", ())
    assert_rig(contents)


def test_freemocap_2_with_squares_of_one(tmp_path: Path) -> None:
    """Its reader takes this length for a board that is not known."""
    path = write(tmp_path / "calibration.toml", 1000.0, FREEMOCAP_2.replace("58.0", "1.0"))
    assert problems_of(path, None) == [("calibration_units_unstated", None)]


@pytest.mark.parametrize("square", ["1", "1.0", "true", "'wide'"])
def test_freemocap_without_size_of_board(tmp_path: Path, square: str) -> None:
    metadata = FREEMOCAP.replace("= 39", f"= {square}")
    assert read_contents(write(tmp_path / "rig.toml", 1.0, metadata)).unit is None
