"""OpenCap's and MVPose's pickles, written by ``pickle`` as those programs write them."""

import io
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.registry import read_contents, read_intrinsics
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.geometry.camera import center_in_world
from tests.pipeline.calibration.readers.rigs import RIG, assert_rig, problems_of

# World of an upright board: y = -z, z = y.
BOARD_FROM_UPRIGHT = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]


def opencap(one: Camera, board_from_upright: list[list[int]] = BOARD_FROM_UPRIGHT) -> dict[str, Any]:
    """Values, shapes and order of keys as in a session of OpenCap."""
    width, height = one.size_px
    rotation = one.cam_from_world.rotation @ np.array(board_from_upright).T
    return {
        "distortion": one.distortion.reshape(1, 5),
        "intrinsicMat": one.matrix,
        "imageSize": np.array([[float(height)], [float(width)]]),
        "rotation": rotation,
        "translation": 1000.0 * one.cam_from_world.translation_m.reshape(3, 1),
        "rotation_EulerAngles": np.zeros((3, 1)),
    }


def zipped(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("form", ["Videos/{}/cameraIntrinsicsExtrinsics.pickle", "{}.pickle", "{}.pkl"])
def test_opencap(tmp_path: Path, protocol: int, form: str) -> None:
    path = tmp_path / "session.zip"
    path.write_bytes(zipped({form.format(one.name): pickle.dumps(opencap(one), protocol) for one in RIG}))
    contents = read_contents(path)
    assert (contents.format, contents.unit, contents.axes) == ("OpenCap", "mm", "y down, turned to Z up")
    assert contents.notes == ()
    assert_rig(contents)


@pytest.mark.parametrize(
    ("board_from_upright", "axes"),
    [
        ([[-1, 0, 0], [0, 0, 1], [0, 1, 0]], "y up, turned to Z up"),
        ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], "z down, turned to Z up"),
        ([[0, 1, 0], [0, 0, -1], [-1, 0, 0]], "y down, turned to Z up"),
    ],
)
def test_cameras_tell_how_board_stood(tmp_path: Path, board_from_upright: list[list[int]], axes: str) -> None:
    """Upside down on the wall, on the floor, and upright but seen from another side."""
    path = tmp_path / "session.zip"
    path.write_bytes(
        zipped({f"{camera.name}.pickle": pickle.dumps(opencap(camera, board_from_upright)) for camera in RIG})
    )
    contents = read_contents(path)
    assert (contents.axes, contents.notes) == (axes, ())
    for found, one in zip(contents.cameras, RIG, strict=True):
        # Z is up, whatever the turn about it.
        np.testing.assert_allclose(center_in_world(found)[2], center_in_world(one)[2], atol=1e-9)
        np.testing.assert_allclose(found.cam_from_world.rotation[:, 2], one.cam_from_world.rotation[:, 2], atol=1e-9)


def test_cameras_that_look_down_tell_no_vertical_axis(tmp_path: Path) -> None:
    """Two phones above the floor, turned against each other."""
    above = [[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], [[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]]
    documents = {f"Cam{k}.pickle": opencap(RIG[0]) | {"rotation": np.array(turn)} for k, turn in enumerate(above)}
    path = tmp_path / "session.zip"
    path.write_bytes(zipped({name: pickle.dumps(document) for name, document in documents.items()}))
    contents = read_contents(path)
    assert contents.axes == "y down, turned to Z up"
    assert "taken to have stood upright" in contents.notes[0]


@pytest.mark.parametrize("form", ["{}/Deployed/cameraIntrinsics.pickle", "{}.pickle"])
def test_intrinsics_of_phone_alone(tmp_path: Path, form: str) -> None:
    """As OpenCap keeps them for each model of phone."""
    intrinsics = {key: opencap(RIG[0])[key] for key in ("distortion", "intrinsicMat", "imageSize")}
    path = tmp_path / "iPhone12,8.zip"
    path.write_bytes(zipped({form.format("phone"): pickle.dumps(intrinsics)}))
    with pytest.raises(InputError, match="intrinsics of 1 camera and no rotation or translation") as error:
        read_contents(path)
    (problem,) = error.value.problems
    assert problem.code == "calibration_unposed"
    assert "extrinsics" in str(problem.hint)
    (camera,) = read_intrinsics(path).cameras
    assert camera.size_px == RIG[0].size_px
    np.testing.assert_array_equal(camera.matrix, RIG[0].matrix)


def test_portrait_phone_has_its_height_first(tmp_path: Path) -> None:
    document = opencap(replace(RIG[0], size_px=(720, 1280)))
    path = tmp_path / "Cam0.pickle"
    path.write_bytes(pickle.dumps(document))
    (camera,) = read_contents(path).cameras
    assert (camera.name, camera.size_px) == ("Cam0", (720, 1280))


def mvpose() -> dict[str, Any]:
    poses = [np.column_stack([one.cam_from_world.rotation, one.cam_from_world.translation_m]) for one in RIG]
    matrices = np.stack([one.matrix for one in RIG])
    return {
        "K": matrices.astype(np.float32),
        "P": matrices @ np.stack(poses),
        "RT": np.stack(poses).astype(np.float32),
    }


@pytest.mark.parametrize("protocol", [3, 5])
def test_mvpose(tmp_path: Path, protocol: int) -> None:
    path = tmp_path / "camera_parameter.pickle"
    path.write_bytes(pickle.dumps(mvpose(), protocol))
    contents = read_contents(path)
    assert (contents.format, contents.unit) == ("MVPose pickle", None)
    assert [one.section for one in contents.cameras] == ["Camera0", "Camera1"]
    plain = tuple(replace(one, name=str(k), size_px=UNKNOWN_SIZE, distortion=np.zeros(0)) for k, one in enumerate(RIG))
    assert_rig(contents, plain, num_digits=2)
    in_mm = read_contents(path, "mm").cameras[0].cam_from_world.translation_m
    np.testing.assert_allclose(in_mm, contents.cameras[0].cam_from_world.translation_m / 1000, rtol=1e-12)


@pytest.mark.parametrize(
    "size", [{"image_size": [1920, 1080]}, {"imgsize": np.array([[1920, 1080]] * 2)}, {"w": 1920, "h": 1080}]
)
def test_mvpose_with_sizes(tmp_path: Path, size: dict[str, Any]) -> None:
    document = mvpose() | size | {"sequence": "walk"}
    path = tmp_path / "camera_parameter.pickle"
    path.write_bytes(pickle.dumps(document))
    contents = read_contents(path)
    assert [one.size_px for one in contents.cameras] == [(1920, 1080)] * 2
    assert contents.notes == ("camera_parameter.pickle: fields that are not read: sequence.",)
    path.write_bytes(pickle.dumps(document | {"dist": np.stack([one.distortion for one in RIG])}))
    assert problems_of(path) == [("unsupported_lens", None)]


def test_lens_that_opencap_does_not_name_is_problem(tmp_path: Path) -> None:
    path = tmp_path / "Cam0.pickle"
    path.write_bytes(pickle.dumps(opencap(RIG[0]) | {"lens": 2.0 * RIG[0].distortion}))
    assert problems_of(path) == [("unsupported_lens", None)]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"intrinsicMat": np.eye(2)}, "invalid_matrix"),
        ({"rotation": 2 * np.eye(3)}, "invalid_rotation"),
        ({"translation": np.zeros((2, 1))}, "invalid_translation"),
        ({"distortion": np.full((1, 5), np.nan)}, "invalid_distortion"),
        ({"imageSize": np.zeros((2, 1))}, "invalid_size"),
        ({"imageSize": "720 x 1280"}, "calibration_unreadable"),
    ],
)
def test_wrong_values_are_reported(tmp_path: Path, changes: dict[str, Any], code: str) -> None:
    path = tmp_path / "Cam0.pickle"
    path.write_bytes(pickle.dumps(opencap(RIG[0]) | changes))
    assert [found for found, _ in problems_of(path)] == [code]


@pytest.mark.parametrize("document", [{}, [], {"K": np.eye(3)}, opencap(RIG[0]) | {"rotation": None}])
def test_other_contents_are_refused(tmp_path: Path, document: Any) -> None:
    path = tmp_path / "Cam0.pickle"
    path.write_bytes(pickle.dumps(document))
    (found,) = {code for code, _ in problems_of(path)}
    assert found in {"calibration_unreadable", "calibration_unposed"}
