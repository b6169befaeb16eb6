"""GLB files, checked by Khronos' validator and three.js, and their body mesh."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.export.writers import glb
from pipeline.export.writers.body_mesh import body_mesh
from pipeline.skeleton.model import CHILDREN, INDEX, SKELETON, forward_kinematics, rest_offsets_m
from tests.e2e.foreign import read_with_three, validate_with_khronos
from tests.pipeline.export.writers.test_bvh import walk


@pytest.mark.parametrize("num_frames", [1, 2, 700])
@pytest.mark.parametrize("rate_hz", [25.0, 30000 / 1001, 120000 / 1001])
def test_takes_of_any_length_and_rate(num_frames: int, rate_hz: float, tmp_path: Path) -> None:
    motion = walk(num_frames, rate_hz)
    path = tmp_path / "person.glb"
    path.write_bytes(b"".join(glb.encode(motion)))
    issues = validate_with_khronos([path])[path]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
    expected_m = forward_kinematics(motion)
    (own_m,) = glb.read_xyz_m(path)
    np.testing.assert_allclose(own_m, expected_m, atol=1e-5)
    found = read_with_three([path])[path]
    for joint, index in INDEX.items():
        x, y, z = expected_m[:, index].T
        np.testing.assert_allclose(found.positions[joint], np.column_stack([x, z, -y]), atol=1e-4)
    assert num_frames == 1 or found.frame_rate_hz == pytest.approx(rate_hz, rel=1e-4)


@pytest.mark.parametrize("name", ["José  Peña 2", "撮影-1", 'a "b" / \\ c'])
def test_names_are_kept(name: str, tmp_path: Path) -> None:
    path = tmp_path / "person.glb"
    content = b"".join(glb.encode(replace(walk(2), name=name, start_frame=7)))
    path.write_bytes(content)
    assert validate_with_khronos([path])[path]["numErrors"] == 0
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    assert document["nodes"][0]["name"] == document["animations"][0]["name"] == name
    assert document["animations"][0]["extras"]["start_frame"] == 7


def test_the_same_motion_gives_the_same_bytes() -> None:
    assert b"".join(glb.encode(walk(5))) == b"".join(glb.encode(walk(5)))


def test_the_body_is_closed_about_every_bone_and_shows_its_outside() -> None:
    offsets_m = rest_offsets_m(walk(1).bone_length_m)
    rest_m = np.zeros_like(offsets_m)
    for index, joint in enumerate(SKELETON[1:], 1):
        rest_m[index] = rest_m[INDEX[str(joint.parent)]] + offsets_m[index]
    mesh = body_mesh(offsets_m, rest_m)
    with_bones = {INDEX[name] for name in INDEX if set(CHILDREN[name]) - {"LeftShoulder", "RightShoulder"}}
    assert set(mesh.joint.tolist()) == with_bones
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1.0)
    corners_m = mesh.vertices[mesh.triangles]
    facing = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    assert (np.einsum("ti,ti->t", facing, mesh.normals[mesh.triangles].mean(1)) > 0).all()
    # Closed surfaces enclose a volume: what flows out of them of a field that grows by 1 a metre along z. Half of the
    # bones' boxes is what so round shapes fill about.
    volume_m3 = (facing[:, 2] / 2 * corners_m[..., 2].mean(1)).sum()
    assert 0.03 < volume_m3 < 0.12
    assert mesh.vertices[:, 2].max() == pytest.approx(rest_m[INDEX["HeadEnd"], 2], abs=0.01)
