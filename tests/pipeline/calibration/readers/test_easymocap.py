"""EasyMocap's two files, as its writer writes them by OpenCV."""

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.core.errors import InputError
from tests.pipeline.calibration.readers.filestorage import write_storage
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, camera, problems_of


def easymocap(with_sizes: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fields of ``intri.yml`` and of ``extri.yml``."""
    intri: dict[str, Any] = {"names": [rig_camera.name for rig_camera in RIG]}
    extri: dict[str, Any] = {"names": [rig_camera.name for rig_camera in RIG]}
    for rig_camera in RIG:
        intri[f"K_{rig_camera.name}"] = rig_camera.matrix
        intri[f"dist_{rig_camera.name}"] = rig_camera.distortion.reshape(1, 5)
        if with_sizes:
            intri |= {f"H_{rig_camera.name}": rig_camera.size_px[1], f"W_{rig_camera.name}": rig_camera.size_px[0]}
        rotation = rig_camera.cam_from_world.rotation
        extri[f"R_{rig_camera.name}"] = Rotation.from_matrix(rotation).as_rotvec().reshape(3, 1)
        extri[f"Rot_{rig_camera.name}"] = rotation
        extri[f"T_{rig_camera.name}"] = rig_camera.cam_from_world.translation_m.reshape(3, 1)
    return intri, extri


def write(folder: Path, way: str, intri: dict[str, Any], extri: dict[str, Any]) -> Path:
    """Write both files, in a zip or one after the other."""
    parts = [write_storage(folder / "intri.yml", intri), write_storage(folder / "extri.yml", extri)]
    path = folder / f"rig.{'zip' if way == 'zip' else 'yml'}"
    if way == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            for part in parts:
                archive.write(part, part.name)
    else:
        path.write_bytes(b"".join(part.read_bytes() for part in parts))
    return path


@pytest.mark.parametrize("with_sizes", [True, False])
@pytest.mark.parametrize("way", ["zip", "joined"])
def test_easymocap(tmp_path: Path, way: str, with_sizes: bool) -> None:
    intri, extri = easymocap(with_sizes)
    contents = read_contents(write(tmp_path, way, intri, extri))
    assert (contents.format, contents.unit, contents.notes) == ("EasyMocap", None, ())
    if not with_sizes:
        assert all(rig_camera.size_px == UNKNOWN_SIZE for rig_camera in contents.cameras)
        contents = replace(
            contents, cameras=tuple(replace(rig_camera, size_px=(1920, 1080)) for rig_camera in contents.cameras)
        )
    assert_rig(contents)


def test_easymocap_with_sizes_and_lenses_under_other_names(tmp_path: Path) -> None:
    intri, extri = easymocap(False)
    for one in RIG:
        intri |= {f"image_width_{one.name}": one.size_px[0], f"image_height_{one.name}": one.size_px[1]}
    assert_rig(read_contents(write(tmp_path, "zip", intri, extri)))
    intri["distorsion_left"] = intri.pop("dist_left")
    assert problems_of(write(tmp_path, "zip", intri, extri)) == [("unsupported_lens", None)]


def test_name_that_ends_as_another_one_keeps_its_fields(tmp_path: Path) -> None:
    rig = (replace(RIG[0], name="1"), replace(RIG[1], name="cam_1"))
    parts: list[dict[str, Any]] = [{}, {}]
    for part, fields in zip(parts, easymocap(True), strict=True):
        for key, value in fields.items():
            part[key.replace("left", "1").replace("right", "cam_1")] = value
    contents = read_contents(write(tmp_path, "zip", *parts))
    assert contents.notes == ()
    assert_rig(contents, rig)


def test_easymocap_without_extrinsics(tmp_path: Path) -> None:
    path = write_storage(tmp_path / "intri.yml", easymocap(True)[0])
    assert problems_of(path) == [("calibration_unposed", None)]
    assert [rig_camera.name for rig_camera in read_intrinsics(path).cameras] == [rig_camera.name for rig_camera in RIG]


@pytest.mark.parametrize("way", ["zip", "joined"])
def test_more_intrinsics_than_extrinsics(tmp_path: Path, way: str) -> None:
    """Phones whose intrinsics are known, and those that stood in the room."""
    intri, extri = easymocap(True)
    third = camera("third", 1.9)
    intri["names"].append("third")
    intri |= {"K_third": third.matrix, "dist_third": third.distortion.reshape(1, 5)}
    path = write(tmp_path, way, intri, extri)
    contents = read_contents(path)
    assert contents.notes == (f"{path.name}: camera third is left out: no pose in the file.",)
    assert_rig(contents)


def test_more_extrinsics_than_intrinsics(tmp_path: Path) -> None:
    intri, extri = easymocap(True)
    extri |= {"R_third": np.zeros((3, 1)), "T_third": np.zeros((3, 1))}
    contents = read_contents(write(tmp_path, "zip", intri, extri))
    assert contents.notes == ("rig.zip: camera third is left out: no camera matrix in the file.",)
    assert_rig(contents)


def test_extrinsics_alone_ask_for_the_intrinsics(tmp_path: Path) -> None:
    path = write_storage(tmp_path / "extri.yml", easymocap(with_sizes=False)[1])
    with pytest.raises(InputError, match=r"extrinsics of 2 cameras and no camera matrix.*intri\.yml.*zip"):
        read_contents(path)


def test_folder_of_calibration_files_asks_for_a_zip(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"folder.*zip"):
        read_contents(tmp_path)
