"""GLB files, checked by Khronos' validator and three.js, and their body mesh."""

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import GLTF
from pipeline.export.writers import glb
from pipeline.export.writers.body_mesh import BodyMesh, capsules
from pipeline.motion.skeleton.model import (
    INDEX,
    child_names,
    find_skeleton,
    forward_kinematics,
    parent_indices,
    rest_offsets_m,
)
from tests.e2e.foreign import read_with_three, validate_with_khronos
from tests.pipeline.export.writers.test_bvh import MOTIONS, walk, with_fingers

RATES_HZ = (25.0, 30000 / 1001, 120000 / 1001)


@pytest.mark.parametrize(
    "takes",
    [
        [*itertools.product((1, 2), RATES_HZ), (700, RATES_HZ[-1])],
        pytest.param([(700, rate_hz) for rate_hz in RATES_HZ[:-1]], marks=pytest.mark.slow),
    ],
    ids=["quick", "long"],
)
@MOTIONS
def test_takes_of_any_length_and_rate(
    dressed: Callable[[SkeletonMotion], SkeletonMotion], takes: list[tuple[int, float]], tmp_path: Path
) -> None:
    motions = {}
    for num_frames, rate_hz in takes:
        path = tmp_path / f"{num_frames} at {rate_hz:.3f}.glb"
        motions[path] = dressed(walk(num_frames, rate_hz))
        path.write_bytes(b"".join(glb.encode(motions[path], np.zeros(3))))
    # Programs that start once read all files.
    for path, issues in validate_with_khronos(list(motions)).items():
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), (path, issues["messages"])
    by_path = read_with_three(list(motions))
    assert by_path.keys() == motions.keys()
    for path, motion in motions.items():
        expected_m, found = forward_kinematics(motion), by_path[path]
        own_m = np.concatenate(list(glb.read_xyz_m(path)))
        np.testing.assert_allclose(own_m, expected_m, atol=1e-5, err_msg=path.name)
        for index, joint in enumerate(find_skeleton(expected_m.shape[1])):
            x, y, z = expected_m[:, index].T
            seen = found.positions[joint.name]
            np.testing.assert_allclose(seen, np.column_stack([x, z, -y]), atol=1e-4, err_msg=path.name)
        assert len(expected_m) == 1 or found.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-4), path


@pytest.mark.parametrize("name", ["José  Peña 2", "撮影-1", 'a "b" / \\ c'])
def test_names_are_kept(name: str, tmp_path: Path) -> None:
    path = tmp_path / "person.glb"
    content = b"".join(glb.encode(replace(walk(2), name=name, start_frame=7), np.zeros(3)))
    path.write_bytes(content)
    assert validate_with_khronos([path])[path]["numErrors"] == 0
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    assert document["nodes"][0]["name"] == document["animations"][0]["name"] == name
    assert document["animations"][0]["extras"]["start_frame"] == 7


def test_same_motion_gives_same_bytes() -> None:
    assert b"".join(glb.encode(walk(5), np.zeros(3))) == b"".join(glb.encode(walk(5), np.zeros(3)))


def mesh_of(motion: SkeletonMotion) -> tuple[BodyMesh, np.ndarray]:
    """Build the mesh of a motion's body in world axes; also return the rest positions of its joints."""
    offsets_m = rest_offsets_m(motion.bone_length_m)
    rest_m = np.zeros_like(offsets_m)
    for index, parent in enumerate(parent_indices(len(offsets_m))[1:], 1):
        rest_m[index] = rest_m[parent] + offsets_m[index]
    return capsules(offsets_m, rest_m), rest_m


@MOTIONS
def test_body_mesh_is_closed_and_faces_outside(
    dressed: Callable[[SkeletonMotion], SkeletonMotion],
) -> None:
    mesh, rest_m = mesh_of(dressed(walk(1)))
    children = child_names(len(rest_m))
    with_bones = {INDEX[name] for name in children if set(children[name]) - {"LeftShoulder", "RightShoulder"}}
    assert set(mesh.joints[:, 0].tolist()) == with_bones
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1.0)
    corners_m = mesh.vertices[mesh.triangles]
    facing = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    assert (np.einsum("ti,ti->t", facing, mesh.normals[mesh.triangles].mean(1)) > 0).all()
    # Closed surfaces enclose a volume: what flows out of them of a field that grows by 1 a metre along z. Half of the
    # bones' boxes is what so round shapes fill about.
    volume_m3 = (facing[:, 2] / 2 * corners_m[..., 2].mean(1)).sum()
    assert 0.03 < volume_m3 < 0.12
    assert mesh.vertices[:, 2].max() == pytest.approx(rest_m[INDEX["HeadEnd"], 2], abs=0.01)


def test_fingers_are_thin_and_apart_and_begin_in_flat_palm() -> None:
    motion = with_fingers(walk(1))
    # The axes of GLB files, to which the widths of bones refer.
    offsets_m = GLTF.rest_offsets(motion.bone_length_m)
    rest_m = np.zeros_like(offsets_m)
    for index, parent in enumerate(parent_indices(64)[1:], 1):
        rest_m[index] = rest_m[parent] + offsets_m[index]
    mesh = capsules(offsets_m, rest_m)

    def box_m(*names: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and highest coordinates of the vertices that joints move: to the left, up, to the front."""
        moved_m = mesh.vertices[np.isin(mesh.joints[:, 0], [INDEX[name] for name in names])]
        return moved_m.min(0), moved_m.max(0)

    palm_low_m, palm_high_m = box_m("LeftHand")
    length_m, height_m, width_m = palm_high_m - palm_low_m
    assert height_m < 0.04
    assert 0.07 < width_m < 0.11
    assert 0.07 < length_m < 0.11
    for finger in ("Index", "Middle", "Ring", "Pinky"):
        low_m, high_m = box_m(*(f"LeftHand{finger}{number}" for number in (1, 2, 3)))
        base_m = rest_m[INDEX[f"LeftHand{finger}1"]]
        assert (np.maximum(palm_low_m, base_m - 0.015) < np.minimum(palm_high_m, base_m + 0.015)).all()
        assert 0.01 < high_m[1] - low_m[1] < 0.022
        np.testing.assert_allclose(high_m[0], rest_m[INDEX[f"LeftHand{finger}3End"], 0], atol=0.005)
    # No vertex of the index finger is behind one of the ring finger.
    assert box_m("LeftHandIndex2")[0][2] > box_m("LeftHandRing2")[1][2]
