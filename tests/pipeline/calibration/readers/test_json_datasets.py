"""CMU Panoptic, VoxelPose and MVOR, in the form of the data sets' own files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project
from tests.pipeline.calibration.readers.rigs import POINTS_M, RIG, assert_rig, problems_of
from tests.pipeline.validation.evaluation.datasets.mvor_files import cameras_info

# Panoptic's world: y = -z, z = y.
PANOPTIC_FROM_UPRIGHT = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def panoptic(one: Camera, kind: str = "hd") -> dict[str, Any]:
    return {
        "name": one.name,
        "type": kind,
        "resolution": list(one.size_px),
        "panel": 0,
        "node": 1,
        "K": one.matrix.tolist(),
        "distCoef": one.distortion.tolist(),
        "R": (one.cam_from_world.rotation @ PANOPTIC_FROM_UPRIGHT.T).tolist(),
        "t": (100.0 * one.cam_from_world.translation_m).reshape(3, 1).tolist(),
    }


def write(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document))
    return path


def test_panoptic_is_in_centimetres_with_y_down(tmp_path: Path) -> None:
    document = {"calibDataSource": "160422_calib_norm", "cameras": [panoptic(one) for one in RIG]}
    contents = read_contents(write(tmp_path / "calibration.json", document))
    assert (contents.format, contents.unit, contents.notes) == ("CMU Panoptic JSON", "cm", ())
    assert_rig(contents)
    assert [one.section for one in contents.cameras] == ["hd_left", "hd_right"]


def test_vga_cameras_of_whole_dome_are_left_out(tmp_path: Path) -> None:
    vga = [panoptic(replace(RIG[0], name=f"{k:03}"), "vga") for k in range(480)]
    contents = read_contents(write(tmp_path / "rig.json", {"cameras": [*vga, *(panoptic(one) for one in RIG)]}))
    assert_rig(contents)
    assert contents.notes == (
        "rig.json: cameras 000, 001, 002, 003, 004, 005, 006, 007 and 472 more are left out: VGA, of more than 128 "
        "cameras.",
    )


def voxelpose(one: Camera) -> dict[str, Any]:
    k1, k2, p1, p2, k3 = one.distortion.tolist()
    return {
        "R": one.cam_from_world.rotation.tolist(),
        "T": (1000.0 * center_in_world(one)).reshape(3, 1).tolist(),
        "fx": one.matrix[0, 0],
        "fy": one.matrix[1, 1],
        "cx": one.matrix[0, 2],
        "cy": one.matrix[1, 2],
        "k": [[k1], [k2], [k3]],
        "p": [[p1], [p2]],
    }


def test_voxelpose_has_centres_in_millimetres(tmp_path: Path) -> None:
    contents = read_contents(write(tmp_path / "calibration_shelf.json", {one.name: voxelpose(one) for one in RIG}))
    assert (contents.format, contents.unit) == ("VoxelPose JSON", "mm")
    assert [one.size_px for one in contents.cameras] == [UNKNOWN_SIZE] * 2
    assert_rig(contents, tuple(replace(one, size_px=UNKNOWN_SIZE) for one in RIG))
    assert contents.cameras[0].section == "Cameraleft"


@pytest.mark.parametrize("size", [{"image_width": 1920, "image_height": 1080}, {"size": [1920, 1080]}])
def test_voxelpose_with_size(tmp_path: Path, size: dict[str, Any]) -> None:
    document = {one.name: voxelpose(one) | size | {"model": "Basler"} for one in RIG}
    contents = read_contents(write(tmp_path / "rig.json", document))
    assert contents.notes == ("rig.json: fields that are not read: model.",)
    assert_rig(contents)


@pytest.mark.parametrize("size", [{"image_size": [1920, 1080]}, {"width": 1920, "height": 1080}])
def test_size_beside_cameras_of_voxelpose_is_of_all(tmp_path: Path, size: dict[str, Any]) -> None:
    cameras = {one.name: voxelpose(one) for one in RIG}
    for document in (cameras | size, {"cameras": cameras} | size, {"cameras": [voxelpose(one) for one in RIG]} | size):
        contents = read_contents(write(tmp_path / "rig.json", document))
        assert contents.format == "VoxelPose JSON"
        assert [one.size_px for one in contents.cameras] == [(1920, 1080)] * 2
        np.testing.assert_allclose(project(contents.cameras[1], POINTS_M), project(RIG[1], POINTS_M), atol=1e-6)


def human36m(*subjects: str) -> dict[str, Any]:
    """Human3.6M's parameters, as karfly's camera-parameters.json has them: poses differ from subject to subject."""
    return {
        "intrinsics": {
            one.name: {"calibration_matrix": one.matrix.tolist(), "distortion": one.distortion.tolist()} for one in RIG
        },
        "extrinsics": {
            subject: {
                one.name: {
                    "R": one.cam_from_world.rotation.tolist(),
                    "t": (1000.0 * one.cam_from_world.translation_m + 50.0 * number).reshape(3, 1).tolist(),
                }
                for one in RIG
            }
            for number, subject in enumerate(subjects)
        },
    }


@pytest.mark.parametrize(
    ("name", "subjects"), [("rig.json", ("S1",)), ("camera-parameters-S1.json", ("S1", "S11", "S9"))]
)
def test_human36m_has_subject_of_file_name(tmp_path: Path, name: str, subjects: tuple[str, ...]) -> None:
    contents = read_contents(write(tmp_path / name, human36m(*subjects)))
    assert (contents.format, contents.unit, contents.notes) == ("Human3.6M JSON", "mm", ())
    assert_rig(contents, tuple(replace(one, size_px=UNKNOWN_SIZE) for one in RIG))


def test_human36m_of_several_subjects_asks_for_one(tmp_path: Path) -> None:
    for name in ("camera-parameters.json", "S1-S9.json"):
        path = write(tmp_path / name, human36m("S1", "S9"))
        assert ("calibration_unreadable", None) in problems_of(path)


def test_human36m_by_focal_lengths_has_no_distortion(tmp_path: Path) -> None:
    document = {
        str(number): {
            "R": one.cam_from_world.rotation.tolist(),
            "t": (1000.0 * one.cam_from_world.translation_m).tolist(),
            "f": one.matrix.diagonal()[:2].tolist(),
            "c": one.matrix[:2, 2].tolist(),
        }
        for number, one in enumerate(RIG, 1)
    }
    contents = read_contents(write(tmp_path / "Human36M_subject9_camera.json", document))
    straight = [
        replace(one, name=str(number), size_px=UNKNOWN_SIZE, distortion=np.zeros(0))
        for number, one in enumerate(RIG, 1)
    ]
    assert_rig(contents, tuple(straight))
    assert len(contents.notes) == 1
    document["2"]["f"] = [1.0]
    assert problems_of(write(tmp_path / "rig.json", document)) == [("invalid_matrix", "2")]


@pytest.mark.parametrize(
    ("part", "changes", "code"),
    [
        ("intrinsics", {"calibration_matrix": "none"}, "invalid_matrix"),
        ("intrinsics", {"distortion": [0.1]}, "invalid_distortion"),
        ("S1", {"R": [[1e300] * 3] * 3}, "invalid_rotation"),
        ("S1", {"t": [1.0]}, "invalid_translation"),
    ],
)
def test_faults_of_human36m(tmp_path: Path, part: str, changes: dict[str, Any], code: str) -> None:
    document = human36m("S1")
    (document[part] if part == "intrinsics" else document["extrinsics"][part])["right"] |= changes
    assert problems_of(write(tmp_path / "rig.json", document)) == [(code, "right")]


def test_lens_that_voxelpose_and_panoptic_do_not_name_is_problem(tmp_path: Path) -> None:
    for document in (
        {one.name: voxelpose(one) | {"kc": one.distortion.tolist()[:4]} for one in RIG},
        {"cameras": [panoptic(one) | {"kc": one.distortion.tolist()[:4]} for one in RIG]},
    ):
        assert problems_of(write(tmp_path / "rig.json", document)) == [("unsupported_lens", None)]


def test_faster_voxelpose_lists_cameras_of_sequence(tmp_path: Path) -> None:
    path = write(tmp_path / "calibration.json", {"customized_sequence": [voxelpose(camera) for camera in RIG]})
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("VoxelPose JSON", "mm")
    assert_rig(contents, tuple(replace(one, name=str(k), size_px=UNKNOWN_SIZE) for k, one in enumerate(RIG)))
    assert contents.cameras[1].section == "Camera1"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"K": [[1.0]]}, "invalid_matrix"),
        ({"R": [[1e300] * 3] * 3}, "invalid_rotation"),
        ({"R": "none"}, "invalid_rotation"),
        ({"t": [[1.0], [2.0]]}, "invalid_translation"),
        ({"distCoef": [[0.1, 0.2], [0.3, 0.4]]}, "invalid_distortion"),
        ({"resolution": [1920]}, "invalid_size"),
        ({"name": 3}, "invalid_name"),
    ],
)
def test_faults_of_panoptic(tmp_path: Path, changes: dict[str, Any], code: str) -> None:
    cameras = [panoptic(RIG[0]), panoptic(RIG[1]) | changes]
    camera = "number 2" if "name" in changes else "right"
    assert problems_of(write(tmp_path / "rig.json", {"cameras": cameras})) == [(code, camera)]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"k": "none"}, "invalid_distortion"),
        ({"k": [[1, 2], [3, 4]]}, "invalid_distortion"),
        ({"T": [1e300, 0, 0]}, "invalid_translation"),
        ({"T": [[1, 2], [3]]}, "invalid_translation"),
        ({"R": [[1e300] * 3] * 3}, "invalid_rotation"),
        ({"fx": None}, "invalid_matrix"),
        ({"fx": [1, 2]}, "invalid_matrix"),
    ],
)
def test_faults_of_voxelpose(tmp_path: Path, changes: dict[str, Any], code: str) -> None:
    document = {"0": voxelpose(RIG[0]), "1": voxelpose(RIG[1]) | changes}
    assert problems_of(write(tmp_path / "rig.json", document)) == [(code, "1")]


def test_mvor_has_transforms_from_cameras_in_millimetres(tmp_path: Path) -> None:
    path = write(tmp_path / "camma_mvor_2018.json", {"images": [], "cameras_info": cameras_info(RIG)})
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("CAMMA MVOR JSON", "mm")
    rig = [replace(one, name=f"cam{k}", distortion=np.zeros(5)) for k, one in enumerate(RIG, 1)]
    assert_rig(contents, tuple(rig))
    (note,) = contents.notes
    assert "the distortion in the file is not applied" in note


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"focallength": [500.0]}, "invalid_matrix"),
        ({"principalpoint": "none"}, "invalid_matrix"),
        ({"skew_value": "none"}, "invalid_matrix"),
        ({"imagesize": [640]}, "invalid_size"),
    ],
)
def test_faults_of_mvor(tmp_path: Path, changes: dict[str, Any], code: str) -> None:
    information = cameras_info(RIG)
    information["camParams"]["intrinsics"][1] |= changes
    assert problems_of(write(tmp_path / "rig.json", {"cameras_info": information})) == [(code, "cam2")]


@pytest.mark.parametrize("transform", [[1.0] * 16, [1.0] * 12, "none", [1e300] * 16, None])
def test_transforms_of_mvor_that_are_none(tmp_path: Path, transform: Any) -> None:
    information = cameras_info(RIG)
    information["camParams"]["firstCamToRoomRef"] = transform
    assert problems_of(write(tmp_path / "rig.json", {"cameras_info": information})) == [
        ("calibration_unreadable", None)
    ]
    information = cameras_info(RIG)
    information["camParams"]["extrinsics"][1] = transform
    assert problems_of(write(tmp_path / "rig.json", {"cameras_info": information})) == [("invalid_rotation", "cam2")]
    information["camParams"]["extrinsics"] = transform
    (problem, *_) = problems_of(write(tmp_path / "rig.json", {"cameras_info": information}))
    assert problem[0] in {"calibration_unreadable", "invalid_rotation"}
