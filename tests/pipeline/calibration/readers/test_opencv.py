"""OpenCV's FileStorage in its three notations, and EasyMocap, as their own writers write them."""

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.data.cameras import Camera
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, camera, fisheye, problems_of


def write_storage(path: Path, fields: dict[str, Any]) -> Path:
    """Write fields by OpenCV itself; dicts become maps."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    _write_map(storage, fields)
    storage.release()
    return path


def _write_map(storage: Any, fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        if isinstance(value, dict):
            storage.startWriteStruct(name, cv2.FileNode_MAP)
            _write_map(storage, value)
            storage.endWriteStruct()
        else:
            storage.write(name, value)


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
def test_a_rig_in_one_file(tmp_path: Path, ending: str) -> None:
    path = write_storage(tmp_path / f"rig{ending}", {one.name: fields_of(one) for one in RIG})
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("OpenCV", None)
    assert_rig(contents)


@pytest.mark.parametrize("ending", [".yml", ".xml", ".json"])
def test_a_file_for_each_camera_in_a_zip(tmp_path: Path, ending: str) -> None:
    with zipfile.ZipFile(tmp_path / "rig.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for one in RIG:
            archive.write(
                write_storage(tmp_path / f"{one.name}{ending}", fields_of(one)), f"cameras/{one.name}{ending}"
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
def test_lengths_of_the_distortion(tmp_path: Path, num_coefficients: int) -> None:
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
def test_a_vector_is_a_list_a_row_or_a_column(tmp_path: Path, vector: str) -> None:
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


def easymocap(with_sizes: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fields of ``intri.yml`` and of ``extri.yml``."""
    intri: dict[str, Any] = {"names": [one.name for one in RIG]}
    extri: dict[str, Any] = {"names": [one.name for one in RIG]}
    for one in RIG:
        intri[f"K_{one.name}"] = one.matrix
        intri[f"dist_{one.name}"] = one.distortion.reshape(1, 5)
        if with_sizes:
            intri |= {f"H_{one.name}": one.size_px[1], f"W_{one.name}": one.size_px[0]}
        rotation = one.cam_from_world.rotation
        extri[f"R_{one.name}"] = Rotation.from_matrix(rotation).as_rotvec().reshape(3, 1)
        extri[f"Rot_{one.name}"] = rotation
        extri[f"T_{one.name}"] = one.cam_from_world.translation_m.reshape(3, 1)
    return intri, extri


@pytest.mark.parametrize("with_sizes", [True, False])
@pytest.mark.parametrize("way", ["zip", "joined"])
def test_easymocap(tmp_path: Path, way: str, with_sizes: bool) -> None:
    intri, extri = easymocap(with_sizes)
    parts = [write_storage(tmp_path / "intri.yml", intri), write_storage(tmp_path / "extri.yml", extri)]
    if way == "zip":
        path = tmp_path / "rig.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for part in parts:
                archive.write(part, part.name)
    else:
        path = tmp_path / "rig.yml"
        path.write_bytes(b"".join(part.read_bytes() for part in parts))
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("EasyMocap", "m")
    if not with_sizes:
        assert all(one.size_px == UNKNOWN_SIZE for one in contents.cameras)
        contents = replace(contents, cameras=tuple(replace(one, size_px=(1920, 1080)) for one in contents.cameras))
    assert_rig(contents)
    assert problems_of(path, "mm") == [("calibration_units", None)]


def test_easymocap_without_extrinsics(tmp_path: Path) -> None:
    path = write_storage(tmp_path / "intri.yml", easymocap(True)[0])
    assert problems_of(path) == [("calibration_unposed", None)]
    assert [one.name for one in read_intrinsics(path)] == [one.name for one in RIG]
