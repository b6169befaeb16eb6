"""Cameras written for other programs: read back by our readers, and by the rules of each program's own reader."""

import io
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from defusedxml.ElementTree import fromstring
from scipy.spatial.transform import Rotation

from pipeline.calibration.program_files import PROGRAM_FORMATS, refusals
from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import project
from pipeline.validation.simulation.rigs import Layout, Rig, build_cameras

LENSES = {
    "none": (),
    "four": (-0.08, 0.03, 0.001, -0.002),
    "five": (-0.08, 0.03, 0.001, -0.002, 0.004),
    "eight": (0.3, 0.1, 0.001, -0.002, 0.01, 0.35, 0.12, 0.02),
    "twelve": (0.3, 0.1, 0.001, -0.002, 0.01, 0.35, 0.12, 0.02, 0.001, 0.002, -0.001, 0.001),
    "fisheye": (0.03, -0.01, 0.002, -0.0004),
}
HELD = {
    "qca": {"none", "four", "five"},
    "opencap": LENSES.keys() - {"fisheye"},
    "easymocap": LENSES.keys() - {"fisheye"},
    "colmap": LENSES.keys() - {"twelve"},
    "kalibr": {"none", "four", "fisheye"},
    "mamma": {"none", "four"},
}
POINTS_M = np.random.default_rng(7).uniform((-1.5, -1.5, 0.0), (1.5, 1.5, 2.0), (40, 3))
# Points of a rule's world, and cameras as (matrix, distortion, rotation, translation, is fisheye).
Pinhole = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]


def rig(lens: str) -> tuple[Camera, ...]:
    cameras = build_cameras(Rig(Layout.RING, 4, (4.0, 3.5), 2.1), np.random.default_rng(68))
    return tuple(
        replace(
            camera,
            name=("01", "left", "Cam-2", "c_3")[number],
            distortion=np.array(LENSES[lens]) * (1 + 0.1 * number),
            lens="fisheye" if lens == "fisheye" else "standard",
        )
        for number, camera in enumerate(cameras)
    )


CASES = [(name, lens) for name in PROGRAM_FORMATS for lens in LENSES if lens in HELD.get(name, LENSES)]


@pytest.mark.parametrize(("name", "lens"), CASES)
def test_cameras_survive_each_format(tmp_path: Path, name: str, lens: str) -> None:
    cameras = rig(lens)
    assert refusals(name, cameras, "rig") == []
    path = tmp_path / f"rig{PROGRAM_FORMATS[name].endings[0]}"
    path.write_bytes(PROGRAM_FORMATS[name].encode(cameras))
    found = read_contents(path).cameras
    if name == "kalibr":
        assert [camera.name for camera in found] == ["cam0", "cam1", "cam2", "cam3"]
        assert [camera.section for camera in found] == [camera.name for camera in cameras]
    else:
        by_name = {camera.name: camera for camera in found}
        found = tuple(by_name[camera.name] for camera in cameras)
    for one, camera in zip(found, cameras, strict=True):
        assert (one.size_px, one.lens) == (camera.size_px, camera.lens)
        np.testing.assert_allclose(project(one, POINTS_M), project(camera, POINTS_M), atol=1e-6)


@pytest.mark.parametrize("name", HELD)
def test_lens_that_format_lacks_is_refused(name: str) -> None:
    for lens in LENSES.keys() - HELD[name]:
        problems = refusals(name, rig(lens), "rig")
        assert [(problem.code, problem.camera) for problem in problems] == [
            ("unsupported_lens", camera.name) for camera in rig(lens)
        ]
        number = f"{len(LENSES[lens])} coefficients"
        assert all(("fisheye" if lens == "fisheye" else number) in problem.message for problem in problems)
    skewed = replace(rig("none")[0], matrix=np.array([[900.0, 2.0, 640.0], [0.0, 900.0, 360.0], [0.0, 0.0, 1.0]]))
    assert ["skew" in problem.message for problem in refusals(name, [skewed], "rig")] == [True]


def test_zeros_beyond_coefficients_of_format_are_no_lens() -> None:
    padded = replace(rig("four")[0], distortion=np.array([*LENSES["four"], *[0.0] * 8]))
    assert refusals("mamma", [padded], "rig") == refusals("qca", [padded], "rig") == []


@pytest.mark.parametrize(("name", "camera"), [("easymocap", "a b"), ("colmap", "a b"), ("opencap", ".hidden")])
def test_name_that_format_lacks_is_refused(name: str, camera: str) -> None:
    (problem,) = refusals(name, [replace(rig("none")[0], name=camera)], "rig")
    assert (problem.code, problem.camera) == ("invalid_name", camera)


def members(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def by_qualisys(content: bytes, _: Path) -> list[Pinhole]:
    """Pixels are 64ths, lengths millimetres; the camera looks along -z with y up (Qualisys' real-time protocol)."""
    found = []
    for camera in fromstring(content).findall("cameras/camera"):
        values = {
            name: float(value) for tag in ("intrinsic", "transform") for name, value in camera.find(tag).attrib.items()
        }
        turn = np.array([[values[f"r{row}{column}"] for column in (1, 2, 3)] for row in (1, 2, 3)])
        rotation = np.diag([1.0, -1.0, -1.0]) @ turn
        matrix = np.array(
            [
                [values["focalLengthU"] / 64, 0.0, values["centerPointU"] / 64],
                [0.0, values["focalLengthV"] / 64, values["centerPointV"] / 64],
                [0.0, 0.0, 1.0],
            ]
        )
        names = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
        lens = np.array([values[name] for name in (*names, "radialDistortion3")])
        centre_m = np.array([values[axis] for axis in "xyz"]) / 1000
        found.append((matrix, lens, rotation, -rotation @ centre_m, False))
    return found


def by_opencap(content: bytes, _: Path) -> list[Pinhole]:
    """``pickle.load`` a file a camera, millimetres; points of the board's world have y down."""
    found = []
    for file in members(content).values():
        assert b"numpy._core" not in file
        camera = pickle.loads(file)  # noqa: S301 - our own file
        assert [np.shape(camera[name]) for name in ("imageSize", "rotation", "translation")] == [(2, 1), (3, 3), (3, 1)]
        board_from_world = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        rotation = camera["rotation"] @ board_from_world
        place_m = camera["translation"].ravel() / 1000
        found.append((camera["intrinsicMat"], camera["distortion"], rotation, place_m, False))
    return found


def by_easymocap(content: bytes, folder: Path) -> list[Pinhole]:
    """``cv2.FileStorage`` of both files: names, then ``K_``, ``dist_``, ``H_``, ``W_``, ``R_`` and ``T_`` of each."""
    for name, file in members(content).items():
        (folder / name).write_bytes(file)
    intri, extri = (cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_READ) for name in ("intri.yml", "extri.yml"))
    listed = intri.getNode("names")
    found = []
    for number in range(listed.size()):
        name = listed.at(number).string()
        assert (intri.getNode(f"W_{name}").real(), intri.getNode(f"H_{name}").real()) == (1280, 720)
        turn = cv2.Rodrigues(extri.getNode(f"R_{name}").mat())[0]
        np.testing.assert_allclose(extri.getNode(f"Rot_{name}").mat(), turn, atol=1e-9)
        matrix, lens = intri.getNode(f"K_{name}").mat(), intri.getNode(f"dist_{name}").mat()
        found.append((matrix, lens, turn, extri.getNode(f"T_{name}").mat(), False))
    return found


def by_mamma(content: bytes, _: Path) -> list[Pinhole]:
    """``yaml.safe_load``; quaternion w, x, y, z and translation are the camera's pose in the world."""
    document = yaml.safe_load(content)
    assert (document["extrinsics_convention"], document["quaternion_order"]) == ("cam2world", "wxyz")
    found = []
    for camera in document["cameras"].values():
        assert (camera["camera_model"], camera["distortion_model"]) == ("pinhole", "radtan")
        assert len(camera["distortion_coeffs"]) == 4
        fx, fy, cx, cy = camera["intrinsics"]
        rotation = Rotation.from_quat(camera["rotation_quaternion"], scalar_first=True).as_matrix().T
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        translation = -rotation @ camera["translation"]
        found.append((matrix, np.array(camera["distortion_coeffs"]), rotation, translation, False))
    return found


def by_kalibr(content: bytes, _: Path) -> list[Pinhole]:
    """The chain from the body: ``T_cam_imu`` of the first camera, then ``T_cn_cnm1`` of each next one."""
    document = yaml.safe_load(content)
    pose, found = np.array(document["cam0"]["T_cam_imu"]), []
    for number in range(len(document)):
        camera = document[f"cam{number}"]
        if number:
            pose = np.array(camera["T_cn_cnm1"]) @ pose
        fx, fy, cx, cy = camera["intrinsics"]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        is_fisheye = camera["distortion_model"] == "equidistant"
        found.append((matrix, np.array(camera["distortion_coeffs"]), pose[:3, :3], pose[:3, 3], is_fisheye))
    return found


RULES: dict[str, Callable[[bytes, Path], list[Pinhole]]] = {
    "qca": by_qualisys,
    "opencap": by_opencap,
    "easymocap": by_easymocap,
    "mamma": by_mamma,
    "kalibr": by_kalibr,
}


@pytest.mark.parametrize(("name", "lens"), [(name, lens) for name, lens in CASES if name in RULES])
def test_rules_of_program_project_to_same_pixels(tmp_path: Path, name: str, lens: str) -> None:
    cameras = rig(lens)
    found = RULES[name](PROGRAM_FORMATS[name].encode(cameras), tmp_path)
    for camera, (matrix, distortion, rotation, translation, is_fisheye) in zip(cameras, found, strict=True):
        project_points = cv2.fisheye.projectPoints if is_fisheye else cv2.projectPoints
        seen, _ = project_points(POINTS_M[:, None], cv2.Rodrigues(rotation)[0], translation, matrix, distortion)
        np.testing.assert_allclose(seen[:, 0], project(camera, POINTS_M), atol=1e-6)


def test_equal_cameras_give_equal_bytes() -> None:
    for known in PROGRAM_FORMATS.values():
        assert known.encode(rig("four")) == known.encode(rig("four"))


def test_names_need_no_escape_of_ours(tmp_path: Path) -> None:
    names = 'A "1" <&', "é: #", "0x1", "a.b"
    named = [replace(camera, name=name) for camera, name in zip(rig("four"), names, strict=True)]
    for name in ("multicap", "anipose", "freemocap", "opencv", "qca", "opencap", "mamma"):
        path = tmp_path / f"{name}{PROGRAM_FORMATS[name].endings[0]}"
        path.write_bytes(PROGRAM_FORMATS[name].encode(named))
        found = sorted(read_contents(path).cameras, key=lambda camera: camera.name)
        assert [camera.name for camera in found] == sorted(names)
