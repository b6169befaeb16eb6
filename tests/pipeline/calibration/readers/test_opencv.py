"""OpenCV's FileStorage in its three notations, JARVIS and 4D Association, as their own writers write them."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from tests.pipeline.calibration.readers.filestorage import write_storage
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, camera, fisheye, problems_of


def fields_of(one: Camera) -> dict[str, Any]:
    """Fields by the names of OpenCV's calibration sample."""
    return {
        "calibration_time": "Thu 01 Jan 2026 10:00:00",
        "image_width": one.size_px[0],
        "image_height": one.size_px[1],
        "camera_matrix": one.matrix,
        "distortion_coefficients": one.distortion.reshape(-1, 1),
        "rvec": Rotation.from_matrix(one.cam_from_world.rotation).as_rotvec().reshape(3, 1),
        "tvec": one.cam_from_world.translation_m.reshape(3, 1),
        "avg_reprojection_error": 0.25,
    }


@pytest.mark.parametrize("ending", [".yml", ".yaml", ".xml", ".json"])
def test_rig_in_one_file(tmp_path: Path, ending: str) -> None:
    path = write_storage(tmp_path / f"rig{ending}", {one.name: fields_of(one) for one in RIG})
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("OpenCV", None)
    assert_rig(contents)


@pytest.mark.parametrize("ending", [".yml", ".xml", ".json"])
def test_file_for_each_camera_in_zip(tmp_path: Path, ending: str) -> None:
    with zipfile.ZipFile(tmp_path / "rig.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for rig_camera in RIG:
            archive.write(
                write_storage(tmp_path / f"{rig_camera.name}{ending}", fields_of(rig_camera)),
                f"cameras/{rig_camera.name}{ending}",
            )
    assert_rig(read_contents(tmp_path / "rig.zip"))


def test_units_are_asked_for(tmp_path: Path) -> None:
    fields = {one.name: fields_of(one) | {"tvec": 1000.0 * one.cam_from_world.translation_m} for one in RIG}
    assert_rig(read_contents(write_storage(tmp_path / "rig.yml", fields), "mm"))


@pytest.mark.parametrize("rows", [3, 4])
def test_extrinsics_in_one_matrix(tmp_path: Path, rows: int) -> None:
    fields = {}
    for one in RIG:
        transform = np.vstack([one.cam_from_world.matrix, [0.0, 0.0, 0.0, 1.0]])[:rows]
        fields[one.name] = {
            "image_size": np.array(one.size_px),
            "K": one.matrix,
            "D": one.distortion,
            "extrinsic_matrix": transform,
        }
    assert_rig(read_contents(write_storage(tmp_path / "rig.yml", fields)))


@pytest.mark.parametrize("num_coefficients", [4, 5, 8, 12])
def test_lengths_of_distortion(tmp_path: Path, num_coefficients: int) -> None:
    distortion = tuple(0.01 * np.arange(1, num_coefficients + 1))
    rig = (camera("a", 0.1, distortion), camera("b", 0.2, distortion))
    assert_rig(read_contents(write_storage(tmp_path / "rig.yml", {one.name: fields_of(one) for one in rig})), rig)


def test_14_coefficients_without_tilt_are_12(tmp_path: Path) -> None:
    rig = (camera("a", 0.1, tuple(0.01 * np.arange(1, 13))), camera("b", 0.2))
    fields = {one.name: fields_of(one) for one in rig}
    fields["a"]["distortion_coefficients"] = np.append(rig[0].distortion, [0.0, 0.0])
    assert_rig(read_contents(write_storage(tmp_path / "rig.yml", fields)), rig)
    fields["a"]["distortion_coefficients"] = np.append(rig[0].distortion, [0.0, 0.02])
    assert problems_of(write_storage(tmp_path / "tilted.yml", fields)) == [("unsupported_lens", "a")]


@pytest.mark.parametrize("model", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}, {"fisheye": "true"}])
def test_fisheye(tmp_path: Path, model: dict[str, Any]) -> None:
    rig = (RIG[0], fisheye("right", -0.8))
    fields = {"left": fields_of(rig[0]), "right": fields_of(rig[1]) | model}
    assert_rig(read_contents(write_storage(tmp_path / "rig.yml", fields)), rig)


@pytest.mark.parametrize("vector", ["[1.2, 0.1, -0.3]", "[[1.2, 0.1, -0.3]]", "[[1.2], [0.1], [-0.3]]"])
def test_vector_is_list_row_or_column(tmp_path: Path, vector: str) -> None:
    path = tmp_path / "rig.yml"
    path.write_text(
        f"%YAML:1.0\n---\nleft:\n   K: [[1450., 0., 959.5], [0., 1450., 539.5], [0., 0., 1.]]\n   rvec: {vector}\n"
        f"   tvec: {vector}\n"
    )
    (camera,) = read_contents(path).cameras
    np.testing.assert_allclose(Rotation.from_matrix(camera.cam_from_world.rotation).as_rotvec(), [1.2, 0.1, -0.3])
    np.testing.assert_array_equal(camera.cam_from_world.translation_m, [1.2, 0.1, -0.3])


@pytest.mark.parametrize("vector", ["[1.2, 0.1]", "[[1, 2, 3], [4, 5, 6]]", "[]", "1.2", "[[]]"])
def test_other_rotations_are_refused(tmp_path: Path, vector: str) -> None:
    path = tmp_path / "rig.yml"
    matrix = "[[5, 0, 3], [0, 5, 2], [0, 0, 1]]"
    path.write_text(f"%YAML:1.0\n---\nleft:\n   K: {matrix}\n   rvec: {vector}\n   tvec: [0, 0, 1]\n")
    assert problems_of(path) == [("invalid_rotation", "left")]


def test_omnidirectional_models_are_refused(tmp_path: Path) -> None:
    fields = {"left": fields_of(RIG[0]), "right": fields_of(RIG[1]) | {"camera_model": "omnidir"}}
    assert problems_of(write_storage(tmp_path / "rig.yml", fields)) == [("unsupported_lens", "right")]


def test_all_problems_are_reported_at_once(tmp_path: Path) -> None:
    fields = {
        "left": fields_of(RIG[0]) | {"rvec": np.ones((2, 2))},
        "right": fields_of(RIG[1]) | {"camera_matrix": np.full((3, 3), np.nan), "tvec": np.array([1.0, np.inf, 0.0])},
    }
    assert problems_of(write_storage(tmp_path / "rig.yml", fields)) == [
        ("invalid_rotation", "left"),
        ("invalid_matrix", "right"),
        ("invalid_translation", "right"),
    ]


def jarvis(one: Camera, unit_per_m: float = 1000.0) -> dict[str, Any]:
    """File of a camera as JARVIS writes it: matrices for points that are rows."""
    return {
        "intrinsicMatrix": one.matrix.T.copy(),
        "distortionCoefficients": one.distortion.reshape(1, 5),
        "R": one.cam_from_world.rotation.T.copy(),
        "T": unit_per_m * one.cam_from_world.translation_m.reshape(3, 1),
    }


def write_jarvis(path: Path, unit_per_m: float = 1000.0) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for rig_camera in RIG:
            part = write_storage(path.with_name(f"{rig_camera.name}.yaml"), jarvis(rig_camera, unit_per_m))
            archive.write(part, f"calib_params/12Cam/{part.name}")
    return path


@pytest.mark.parametrize(("unit_per_m", "unit"), [(1000.0, "mm"), (1.0, None)])
def test_jarvis(tmp_path: Path, unit_per_m: float, unit: str | None) -> None:
    """Its tool calibrates in millimetres; a program that writes metres for it is told by the lengths."""
    contents = read_contents(write_jarvis(tmp_path / "rig.zip", unit_per_m))
    assert (contents.format, contents.unit, contents.notes) == ("JARVIS", unit, ())
    assert_rig(contents, tuple(replace(rig_camera, size_px=UNKNOWN_SIZE) for rig_camera in RIG))


def test_jarvis_with_its_parts(tmp_path: Path) -> None:
    """The folders of intrinsics and of extrinsics, from which it makes the files."""
    path = write_jarvis(tmp_path / "rig.zip")
    with zipfile.ZipFile(path, "a") as archive:
        lens = {key: value for key, value in jarvis(RIG[0]).items() if key.startswith(("i", "d"))}
        pose = {key: value for key, value in jarvis(RIG[1]).items() if key in "RT"} | {"E": np.eye(3), "F": np.eye(3)}
        for name, fields in (("Intrinsics_left", lens), ("Extrinsics_left_right", pose)):
            archive.write(write_storage(tmp_path / f"{name}.yaml", fields), f"{name}.yaml")
    contents = read_contents(path, "mm")
    assert [rig_camera.name for rig_camera in contents.cameras] == ["left", "right"]
    assert contents.notes == (
        "rig.zip: camera Extrinsics_left_right is left out: no camera matrix in the file.",
        "rig.zip: camera Intrinsics_left is left out: no pose in the file.",
        "rig.zip: fields that are not read: E, F.",
    )


def plain(fields: dict[str, Any], *, flat: bool = False) -> dict[str, Any]:
    """Fields as JSON holds them, with arrays nested or flat."""
    return {
        key: (value.ravel() if flat else value).tolist() if isinstance(value, np.ndarray) else value
        for key, value in fields.items()
    }


@pytest.mark.parametrize("form", ["flat", "nested", "transform"])
def test_4d_association(tmp_path: Path, form: str) -> None:
    """Its own file has flat matrices and ``RT``; data sets after it have ``R`` and ``T``, flat or nested."""
    cameras = {}
    for one in RIG:
        pose = one.cam_from_world
        fields: dict[str, Any] = {"K": one.matrix, "imgSize": list(one.size_px), "rectifyAlpha": 0.0}
        fields |= {"RT": pose.matrix} if form == "transform" else {"R": pose.rotation, "T": pose.translation_m}
        fields["distCoeff"] = one.distortion
        cameras[one.name] = plain(fields, flat=form != "nested")
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(cameras))
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("4D Association JSON", None)
    assert contents.notes == ("calibration.json: fields that are not read: rectifyAlpha.",)
    assert_rig(contents)


def test_openpose(tmp_path: Path) -> None:
    """A file a camera, named by its serial number; the pose is called the camera matrix."""
    path = tmp_path / "cameras.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for rig_camera in RIG:
            fields = {
                "CameraMatrix": rig_camera.cam_from_world.matrix,
                "CameraMatrixInitial": np.eye(4)[:3],
                "Intrinsics": rig_camera.matrix,
                "Distortion": np.append(rig_camera.distortion, np.zeros(3)).reshape(8, 1),
            }
            archive.write(write_storage(tmp_path / f"{rig_camera.name}.xml", fields), f"models/{rig_camera.name}.xml")
    contents = read_contents(path)
    assert contents.notes == ()
    assert_rig(contents, tuple(replace(rig_camera, size_px=UNKNOWN_SIZE) for rig_camera in RIG))


def test_names_within_mapping_count_if_distinct(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    named = {f"cam_{k}": plain(fields_of(one)) | {"name": one.name} for k, one in enumerate(RIG)}
    path.write_text(json.dumps(named))
    contents = read_contents(path)
    assert [(one.name, one.section) for one in contents.cameras] == [("left", "cam_0"), ("right", "cam_1")]
    path.write_text(json.dumps({key: fields | {"name": "GoPro"} for key, fields in named.items()}))
    assert [(one.name, one.section) for one in read_contents(path).cameras] == [("cam_0", ""), ("cam_1", "")]


@pytest.mark.parametrize("field", ["name", "camera_name", "serial", "id"])
def test_names_in_list(tmp_path: Path, field: str) -> None:
    path = tmp_path / "rig.json"
    listed = [{field: rig_camera.name, **plain(fields_of(rig_camera))} for rig_camera in RIG]
    path.write_text(json.dumps({"camera_rig": 3, "cameras": listed}))
    assert [rig_camera.name for rig_camera in read_contents(path).cameras] == ["left", "right"]


def test_distortion_under_another_name_is_no_unknown_field(tmp_path: Path) -> None:
    fields = {rig_camera.name: fields_of(rig_camera) for rig_camera in RIG}
    fields["right"]["radial_distortion"] = fields["right"].pop("distortion_coefficients")
    path = write_storage(tmp_path / "rig.yml", fields)
    assert problems_of(path) == [("unsupported_lens", None)]


def mv3dpose(one: Camera) -> dict[str, Any]:
    """Camera as mv3dpose's page states its files, whose own programs read ``distCoef``."""
    pose = one.cam_from_world
    return {
        "K": one.matrix.tolist(),
        "rvec": Rotation.from_matrix(pose.rotation).as_rotvec().tolist(),
        "tvec": pose.translation_m.tolist(),
        "discCoef": one.distortion.tolist(),
        "w": one.size_px[0],
        "h": one.size_px[1],
    }


def test_lens_of_mv3dpose_is_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({one.name: mv3dpose(one) for one in RIG}))
    assert_rig(read_contents(path))


def test_unread_lens_is_one_problem_that_names_field_and_cameras(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"

    def other(one: Camera) -> dict[str, Any]:
        return {("kc" if name == "discCoef" else name): value for name, value in mv3dpose(one).items()}

    path.write_text(json.dumps({one.name: other(one) for one in RIG}))
    with pytest.raises(InputError) as error:
        read_contents(path)
    (problem,) = error.value.problems
    assert (problem.code, problem.field) == ("unsupported_lens", "kc")
    assert "left, right" in problem.message
    straight = tuple(replace(one, distortion=np.zeros(5)) for one in RIG)
    path.write_text(json.dumps({one.name: other(one) for one in straight}))
    assert_rig(read_contents(path), straight)


@pytest.mark.parametrize("beside", [{"kc": [-0.11, 0.07, 0.002, -0.003, 0.01]}, {"lens": {"k1": -0.11}}])
def test_lens_beside_cameras_is_not_dropped(tmp_path: Path, beside: dict[str, Any]) -> None:
    path = tmp_path / "rig.json"
    cameras = {one.name: mv3dpose(one) | {"discCoef": None} for one in RIG}
    for document in (cameras | beside, {"cameras": cameras} | beside):
        path.write_text(json.dumps(document))
        assert problems_of(path) == [("unsupported_lens", None)]


@pytest.mark.parametrize(
    "size",
    [
        {"w": 1920, "h": 1080},
        {"imgsize": [1920, 1080]},
        {"Frame_Width": 1920, "FrameHeight": 1080},
        {"img_w": 1920, "img_h": 1080, "image_shape": [1080, 1920, 3]},
        {"image_size": [[1920], [1080]], "W": 1920.0, "H": [[1.0, 0.0], [0.0, 1.0]]},
    ],
)
def test_size_is_read_under_its_usual_names(tmp_path: Path, size: dict[str, Any]) -> None:
    cameras = {one.name: {k: v for k, v in mv3dpose(one).items() if k not in "whdiscCoef"} for one in RIG}
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({name: camera | size for name, camera in cameras.items()}))
    contents = read_contents(path)
    assert ([one.size_px for one in contents.cameras], contents.notes) == ([(1920, 1080)] * 2, ())


def test_sizes_that_contradict_each_other_are_problem(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    cameras = [mv3dpose(one) | {"discCoef": None} for one in RIG]
    path.write_text(json.dumps([cameras[0], cameras[1] | {"imgSize": [1280, 720]}]))
    assert problems_of(path) == [("invalid_size", "1")]


def test_size_under_another_name_is_problem(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    cameras = {one.name: mv3dpose(one) | {"discCoef": None, "dims": [1920, 1080]} for one in RIG}
    path.write_text(json.dumps(cameras))
    assert read_contents(path).notes == ("rig.json: fields that are not read: dims.",)
    del cameras["right"]["w"]
    path.write_text(json.dumps(cameras))
    assert problems_of(path) == [("invalid_size", None)]


def test_jarvis_with_size_is_in_millimetres_still(tmp_path: Path) -> None:
    path = tmp_path / "rig.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for one in RIG:
            fields = jarvis(one) | {"image_width": one.size_px[0], "image_height": one.size_px[1]}
            part = write_storage(tmp_path / f"{one.name}.yaml", fields)
            archive.write(part, part.name)
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("JARVIS", "mm")
    assert_rig(contents)
