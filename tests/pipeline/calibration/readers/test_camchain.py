"""Chains of cameras: Kalibr's, in the form of its own documentation, and MAMMA's, in the form of its public example."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from pipeline.calibration.registry import read_contents
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world, project
from tests.pipeline.calibration.readers.rigs import POINTS_M, RIG, assert_rig, camera, fisheye, problems_of
from tests.pipeline.calibration.readers.test_vicon import RADIAL, ideal_from_seen

# Two cameras of MAMMA's configs/examples/calib/iphones_outdoors.yaml, as the file has them.
IPHONES = """# extrinsics_convention declares how the extrinsics are stored.
extrinsics_convention: cam2world
cameras:
  A001:
    camera_model: pinhole
    distortion_model: radtan
    intrinsics: [2549.58203125, 2549.32763671875, 1899.7073974609375, 1070.603759765625]
    distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
    resolution: [3840, 2160]
    translation: [2.0904661399688286e-10, 4.564202568853248e-09, 1.6341323517870652]
    rotation_quaternion: [-0.6663179239716891, 0.7456649016276135, -0.0014626473840092158,
      -0.0014626473840092158]
  C001:
    camera_model: pinhole
    distortion_model: radtan
    intrinsics: [2557.146484375, 2556.005615234375, 1943.8492431640625, 1070.3726806640625]
    distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
    resolution: [3840, 2160]
    translation: [0.008291670262188149, 9.677266502588996, 1.646911960587219]
    rotation_quaternion: [0.003052764363547088, -0.005394560230002408, 0.7577310957529485,
      -0.6525374823553828]
"""
RADTAN = (camera("left", 0.3, (-0.1, 0.05, 0.001, -0.002)), camera("right", -0.8, (-0.12, 0.04, -0.001, 0.002)))


def lens(one: Camera) -> dict[str, Any]:
    return {
        "camera_model": "pinhole",
        "distortion_model": "equidistant" if one.lens == "fisheye" else "radtan",
        "intrinsics": [float(one.matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2))],
        "distortion_coeffs": one.distortion.tolist(),
        "resolution": list(one.size_px),
    }


def mamma(*cameras: Camera, **conventions: str) -> dict[str, Any]:
    document: dict[str, Any] = {**conventions, "cameras": {}}
    for one in cameras:
        is_inverse = conventions.get("extrinsics_convention") == "world2cam"
        pose = one.cam_from_world if is_inverse else one.cam_from_world.inverse()
        is_scalar_first = conventions.get("quaternion_order") != "xyzw"
        quaternion = Rotation.from_matrix(pose.rotation).as_quat(scalar_first=is_scalar_first).tolist()
        document["cameras"][one.name] = lens(one) | {
            "translation": pose.translation_m.tolist(),
            "rotation_quaternion": quaternion,
        }
    return document


def kalibr(*cameras: Camera) -> dict[str, Any]:
    chain: dict[str, Any] = {}
    for number, one in enumerate(cameras):
        chain[f"cam{number}"] = lens(one) | {"cam_overlaps": [1 - number], "rostopic": f"/{one.name}/image_raw"}
        if number:
            step = one.cam_from_world @ cameras[number - 1].cam_from_world.inverse()
            chain[f"cam{number}"]["T_cn_cnm1"] = [*step.matrix.tolist(), [0.0, 0.0, 0.0, 1.0]]
    return chain


def write(path: Path, document: Any) -> Path:
    path.write_text(yaml.safe_dump(document))
    return path


def test_public_example_of_mamma(tmp_path: Path) -> None:
    path = tmp_path / "iphones_outdoors.yaml"
    path.write_text(IPHONES)
    contents = read_contents(path)
    assert (contents.format, contents.unit, contents.notes) == ("MAMMA YAML", "m", ())
    assert [(one.name, one.size_px) for one in contents.cameras] == [("A001", (3840, 2160)), ("C001", (3840, 2160))]
    first, facing = contents.cameras
    np.testing.assert_allclose(center_in_world(facing), [0.00829167, 9.67726650, 1.64691196], atol=1e-8)
    # Both phones stand upright at the ends of a court, and see each other in the middle of their pictures.
    for one, other in ((first, facing), (facing, first)):
        assert one.cam_from_world.rotation[1] @ [0.0, 0.0, -1.0] > 0.98
        assert (np.abs(project(one, center_in_world(other)) - [1920, 1080]) < [400, 400]).all()


@pytest.mark.parametrize("convention", ["cam2world", "world2cam"])
@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_conventions_of_mamma(tmp_path: Path, convention: str, order: str) -> None:
    document = mamma(*RADTAN, extrinsics_convention=convention, quaternion_order=order)
    assert_rig(read_contents(write(tmp_path / "rig.yaml", document)), RADTAN, num_digits=9)


def test_lens_of_vicon_in_mamma_is_fitted(tmp_path: Path) -> None:
    document = mamma(camera("left", 0.3, ()))
    document["cameras"]["left"] |= {
        "distortion_model": "vicon_radial_2",
        "distortion_coeffs": [951.5, 548.25, *RADIAL],
    }
    (one,) = read_contents(write(tmp_path / "rig.yaml", document)).cameras
    ideal_px = project(replace(one, distortion=np.zeros(5)), POINTS_M)
    seen_px = project(one, POINTS_M)
    np.testing.assert_allclose(ideal_from_seen(seen_px, np.array([951.5, 548.25]), RADIAL), ideal_px, atol=0.05)
    document["cameras"]["left"]["distortion_coeffs"] = [951.5, 548.25, 1.0, 0.0, 0.0]
    assert problems_of(write(tmp_path / "rig.yaml", document)) == [("unsupported_lens", "left")]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"distortion_model": "fov"}, "unsupported_lens"),
        ({"camera_model": "omni"}, "unsupported_lens"),
        ({"intrinsics": [900.0]}, "invalid_matrix"),
        ({"intrinsics": "none"}, "invalid_matrix"),
        ({"distortion_coeffs": [0.1]}, "invalid_distortion"),
        ({"resolution": [1920]}, "invalid_size"),
        ({"rotation_quaternion": [0.0, 0.0, 0.0, 0.0]}, "invalid_rotation"),
        ({"rotation_quaternion": "none"}, "invalid_rotation"),
        ({"translation": [1e300, 0.0, 0.0]}, "invalid_rotation"),
        ({"kc": [0.1, 0.2, 0.3, 0.4]}, "unsupported_lens"),
    ],
)
def test_faults_of_mamma(tmp_path: Path, changes: dict[str, Any], code: str) -> None:
    document = mamma(*RADTAN)
    document["cameras"]["right"] |= changes
    camera_name = None if "kc" in changes else "right"
    assert problems_of(write(tmp_path / "rig.yaml", document)) == [(code, camera_name)]


def test_unknown_convention_of_mamma_is_refused(tmp_path: Path) -> None:
    document = mamma(*RADTAN) | {"extrinsics_convention": "c2w", "quaternion_order": "zyxw"}
    assert problems_of(write(tmp_path / "rig.yaml", document)) == [("calibration_unreadable", None)] * 2


def test_chain_of_kalibr_has_world_of_first_camera_upright(tmp_path: Path) -> None:
    rig = (*RADTAN, fisheye("third", 0.4))
    contents = read_contents(write(tmp_path / "camchain.yaml", kalibr(*rig)))
    assert (contents.format, contents.unit, contents.axes) == ("Kalibr", "m", "y down, turned to Z up")
    names = [(one.name, one.section) for one in contents.cameras]
    assert names == [("cam0", "left"), ("cam1", "right"), ("cam2", "third")]
    np.testing.assert_allclose(center_in_world(contents.cameras[0]), 0.0, atol=1e-12)
    upright_from_first = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    in_world_m = rig[0].cam_from_world.apply(POINTS_M) @ upright_from_first.T
    for one, expected in zip(contents.cameras, rig, strict=True):
        np.testing.assert_allclose(project(one, in_world_m), project(expected, POINTS_M), atol=1e-6)


def test_broken_chain_leaves_out_cameras_after_it(tmp_path: Path) -> None:
    document = kalibr(*RADTAN, fisheye("third", 0.4), fisheye("fourth", 0.2))
    del document["cam2"]["T_cn_cnm1"]
    contents = read_contents(write(tmp_path / "camchain.yaml", document))
    assert [one.name for one in contents.cameras] == ["cam0", "cam1"]
    assert contents.notes == ("camchain.yaml: cameras cam2, cam3 are left out: no pose in the file.",)


@pytest.mark.parametrize("transform", ["none", [[1.0]], [[1e300] * 4, [0.0] * 4, [0.5] * 4, [1.5] * 4]])
def test_transform_of_kalibr_that_is_none_is_refused(tmp_path: Path, transform: Any) -> None:
    document = copy.deepcopy(kalibr(*RIG))
    document["cam1"]["T_cn_cnm1"] = transform
    problems = problems_of(write(tmp_path / "camchain.yaml", document))
    assert ("invalid_rotation", "cam1") in problems
