"""FBX files, read by our own reader and by three.js."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.options.config import Preset
from pipeline.export.presets import PRESETS
from pipeline.export.writers import fbx
from pipeline.export.writers.fbx_nodes import ArrayProperty, Node, read
from pipeline.export.writers.fbx_stored import StoredScene, numbers, object_name, typed_property
from pipeline.motion.skeleton.model import INDEX, find_skeleton, forward_kinematics
from tests.e2e.foreign import read_with_three
from tests.pipeline.export.writers.test_bvh import tumbling, walk, with_fingers

RATES_HZ = (25.0, 30000 / 1001, 24000 / 1001, 240.0, 31.7)
MODES = {25.0: 10, 30000 / 1001: 9, 24000 / 1001: 13, 240.0: 14, 31.7: 14, 120000 / 1001: 18}
NOWHERE = np.zeros(3)


def written(motion: SkeletonMotion, path: Path, preset: Preset = "default") -> Path:
    path.write_bytes(b"".join(fbx.encode(motion, preset, NOWHERE)))
    return path


def scene_of(path: Path) -> StoredScene:
    return StoredScene(read(path.read_bytes()))


def own_m(path: Path, preset: Preset = "default") -> np.ndarray:
    return np.concatenate(list(fbx.read_xyz_m(path, preset)))


@pytest.mark.parametrize(
    "dressed",
    [
        pytest.param(lambda motion: motion, id="body"),
        pytest.param(with_fingers, id="fingers", marks=pytest.mark.slow),
    ],
)
def test_takes_of_any_length_and_rate(dressed: Callable[[SkeletonMotion], SkeletonMotion], tmp_path: Path) -> None:
    motions = {}
    for num_frames, rate_hz in [*itertools.product((1, 2), RATES_HZ), (530, 120000 / 1001)]:
        motion = dressed(walk(num_frames, rate_hz))
        motions[written(motion, tmp_path / f"{num_frames} at {rate_hz:.3f}.fbx")] = motion
    # Programs that start once read all files.
    by_path = read_with_three(list(motions))
    assert by_path.keys() == motions.keys()
    for path, motion in motions.items():
        expected_m, found = forward_kinematics(motion), by_path[path]
        np.testing.assert_allclose(own_m(path), expected_m, atol=1e-5, err_msg=path.name)
        for index, joint in enumerate(find_skeleton(expected_m.shape[1])):
            x, y, z = 100.0 * expected_m[:, index].T
            seen = found.positions[joint.name]
            np.testing.assert_allclose(seen, np.column_stack([x, z, -y]), atol=1e-2, err_msg=path.name)
        assert len(expected_m) == 1 or found.frame_rate_hz == pytest.approx(motion.frame_rate_hz, rel=1e-6), path
        stated = scene_of(path).global_settings
        assert numbers(stated, "CustomFrameRate", 1) == (motion.frame_rate_hz,)
        assert numbers(stated, "TimeMode", 1) == (MODES[motion.frame_rate_hz],)


@pytest.mark.parametrize("preset", PRESETS)
def test_presets(preset: Preset, tmp_path: Path) -> None:
    motion = with_fingers(tumbling(60))
    path = written(motion, tmp_path / "person.fbx", preset)
    np.testing.assert_allclose(own_m(path, preset), forward_kinematics(motion), atol=1e-5)
    scene, convention = scene_of(path), PRESETS[preset]
    names = [object_name(node) for node in scene.find_all("Model", "LimbNode").values()]
    expected = [convention.name(joint.name) for joint in find_skeleton(len(motion.bone_length_m))]
    assert names == expected
    (top,) = scene.find_all("Model", "Null").values()
    assert object_name(top) == {"unreal": "root", "humanik": "Reference"}.get(preset, motion.name)
    unit_cm = numbers(scene.global_settings, "UnitScaleFactor", 1)
    assert unit_cm == (100.0 if preset == "blender" else 1.0,)
    assert [numbers(scene.global_settings, f"{axis}Axis", 1) for axis in ("Up", "Front", "Coord")] == [(1,), (2,), (0,)]


def test_feet_end_in_toes_of_target_software(tmp_path: Path) -> None:
    scene = scene_of(written(walk(1), tmp_path / "person.fbx", "unreal"))
    limbs = {object_name(node): limb for limb, node in scene.find_all("Model", "LimbNode").items()}
    assert scene.parent(limbs["ball_l"], "Model") == limbs["foot_l"]
    names = {preset: PRESETS[preset].name("RightFootEnd") for preset in PRESETS}
    assert names == {
        **{"default": "RightFootEnd", "blender": "toe.R", "unity-humanoid": "RightToes", "unreal": "ball_r"},
        **{"mixamo": "mixamorig:RightToeBase", "humanik": "RightToeBase"},
    }


def test_humanik_has_take_of_rest_pose(tmp_path: Path) -> None:
    path = written(tumbling(), tmp_path / "person.fbx", "humanik")
    scene = scene_of(path)
    assert [object_name(node) for node in scene.find_all("AnimationStack", "").values()] == [
        "person-1",
        "T-pose",
    ]
    motion, rest = scene.find_all("AnimationLayer", "")
    for model, node in scene.find_all("Model", "LimbNode").items():
        for name in ("Lcl Translation", "Lcl Rotation"):
            moving, still = scene.curves(motion, model, name), scene.curves(rest, model, name)
            assert (moving is None) == (still is None)
            if still is not None:
                np.testing.assert_array_equal(still[0], 0)
                np.testing.assert_allclose(np.concatenate(still[1]), numbers(node, name, 3), rtol=1e-6)
    read_by_three = read_with_three([path])[path]
    x, y, z = 100.0 * forward_kinematics(tumbling())[:, INDEX["LeftFoot"]].T
    np.testing.assert_allclose(read_by_three.positions["LeftFoot"], np.column_stack([x, z, -y]), atol=1e-2)


def test_rotation_orders_differ_where_one_interpolates_badly(tmp_path: Path) -> None:
    path = written(tumbling(), tmp_path / "person.fbx")
    models = scene_of(path).find_all("Model", "LimbNode").values()
    orders = {object_name(model): numbers(model, "RotationOrder", 1)[0] for model in models}
    assert len(set(orders.values())) > 1
    assert orders["Head"] == 3  # Y, then X, then Z about fixed axes: Z X Y of BVH
    read_by_three = read_with_three([path])[path]
    for joint in find_skeleton(24):
        x, y, z = 100.0 * forward_kinematics(tumbling())[:, INDEX[joint.name]].T
        np.testing.assert_allclose(read_by_three.positions[joint.name], np.column_stack([x, z, -y]), atol=1e-2)


def test_angles_are_continuous_over_many_turns(tmp_path: Path) -> None:
    """Curves of a spin of three turns, over more frames than a block has."""
    path = written(walk(700), tmp_path / "person.fbx")
    scene = scene_of(path)
    (layer,) = scene.find_all("AnimationLayer", "")
    for model in scene.find_all("Model", "LimbNode"):
        found = scene.curves(layer, model, "Lcl Rotation")
        assert found is None or np.abs(np.diff(found[1], axis=1)).max() < 90.0


def test_groups_of_joints_give_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = b"".join(fbx.encode(walk(60), "default", NOWHERE))
    assert whole == b"".join(fbx.encode(walk(60), "default", NOWHERE))
    monkeypatch.setattr(fbx, "_GROUP_BYTES", 2 * 60 * 12)
    assert whole == b"".join(fbx.encode(walk(60), "default", NOWHERE))


NAMES = {
    "José  Peña 2": "José  Peña 2",
    "撮影-1 👩🏽‍🎤": "撮影-1 👩🏽‍🎤",
    'a "b" / \\ c: d': 'a "b" / \\ c: d',
    "Anna\x00\x01Model": "Anna  Model",
    "\ud800": "person-1",
    "": "person-1",
    "Hips": "Hips (1)",
}


def test_names_are_kept_but_for_separators(tmp_path: Path) -> None:
    motion, paths = walk(2), []
    for number, (name, in_file) in enumerate(NAMES.items()):
        path = written(replace(motion, name=name, start_frame=7), tmp_path / f"{number}.fbx")
        scene = scene_of(path)
        (top,) = scene.find_all("Model", "Null").values()
        assert object_name(top) == in_file
        assert [object_name(node) for node in scene.find_all("AnimationStack", "").values()] == [in_file]
        assert numbers(top, "start_frame", 1) == (7,)
        np.testing.assert_allclose(own_m(path), forward_kinematics(motion), atol=1e-5)
        paths.append(path)
    x, y, z = 100.0 * forward_kinematics(motion)[:, INDEX["LeftHand"]].T
    for read_by_three in read_with_three(paths).values():
        np.testing.assert_allclose(read_by_three.positions["LeftHand"], np.column_stack([x, z, -y]), atol=1e-2)


def test_person_without_frames_has_body_at_rest(tmp_path: Path) -> None:
    motion = walk(1)
    nobody = replace(motion, root_m=motion.root_m[:0], parent_from_joint=motion.parent_from_joint[:0])
    path = written(nobody, tmp_path / "person.fbx")
    assert not list(fbx.read_xyz_m(path, "default"))
    assert len(scene_of(path).find_all("Model", "LimbNode")) == 24


def test_skin_is_bound_in_rest_pose(tmp_path: Path) -> None:
    """Joints in the bind pose are where their offsets place them; feet stand on the floor."""
    scene = scene_of(written(walk(1), tmp_path / "person.fbx"))
    (pose,) = scene.find_all("Pose", "BindPose").values()
    bound = {}
    for node in pose.children[3:]:
        model = node.child("Node")
        assert model is not None
        bound[typed_property(model, 0, int)] = values(node, "Matrix").reshape(4, 4).T
    heights = []
    for limb, stored in scene.find_all("Model", "LimbNode").items():
        above = scene.parent(limb, "Model")
        assert above is not None
        offset = np.array(numbers(stored, "Lcl Translation", 3))
        np.testing.assert_allclose(bound[limb][:3, 3], bound[above][:3, 3] + offset, atol=1e-9)
        heights.append(bound[limb][1, 3])
    assert min(heights) == pytest.approx(0.0, abs=1e-9)
    assert max(heights) == pytest.approx(170.0, abs=15.0)
    clusters = scene.find_all("Deformer", "Cluster").values()
    indices = np.concatenate([values(cluster, "Indexes") for cluster in clusters])
    (mesh,) = scene.find_all("Geometry", "Mesh").values()
    assert sorted(indices) == list(range(len(values(mesh, "Vertices")) // 3))
    for number, cluster in scene.find_all("Deformer", "Cluster").items():
        (joint,) = scene.children(number, "Model")
        np.testing.assert_array_equal(values(cluster, "TransformLink").reshape(4, 4).T, bound[joint])
        np.testing.assert_allclose(values(cluster, "Transform").reshape(4, 4).T @ bound[joint], np.eye(4), atol=1e-9)


def values(node: Node, name: str) -> np.ndarray:
    stored = node.child(name)
    assert stored is not None
    return typed_property(stored, 0, ArrayProperty).values()


def test_file_with_other_contents_is_error(tmp_path: Path) -> None:
    """One of the bytes of a file is another: it is refused, or joints are elsewhere, or the byte has no meaning."""
    motion = walk(20)
    content, expected_m = b"".join(fbx.encode(motion, "default", NOWHERE)), forward_kinematics(motion)
    path, random = tmp_path / "person.fbx", np.random.default_rng(0)
    refused = 0
    for place in random.integers(27, len(content) - 200, 60):
        path.write_bytes(content[:place] + bytes([content[place] ^ (1 << random.integers(8))]) + content[place + 1 :])
        try:
            found_m = own_m(path)
        except OSError:
            refused += 1
        else:
            assert found_m.shape == expected_m.shape
    assert refused > 5
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(OSError, match="damaged"):
        own_m(path)
