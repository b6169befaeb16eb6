"""Motion of a person on rigs that differ: any axes of bones, A-poses, sizes, places and directions."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from api.blender.extension.answers import RequestError
from api.blender.extension.bone_tree import BoneMap, add_trunk, recognise_bones
from api.blender.extension.glb_motion import PersonMotion, read_motion
from api.blender.extension.retarget import RestArmature, RestBone, Retargeting
from api.blender.extension.turns import Quat
from pipeline.export.character.bone_names import LIMBS
from pipeline.export.writers import glb
from tests.api.blender.test_bone_tree import read_tree
from tests.api.blender.test_glb_motion import posed_m
from tests.cases import slow_but
from tests.pipeline.export.character.characters import Bones, bones_of
from tests.pipeline.export.writers.test_bvh import walk, with_fingers

Posed = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> PersonMotion:
    path = tmp_path_factory.mktemp("motion") / "0.glb"
    path.write_bytes(b"".join(glb.encode(with_fingers(walk(30)), np.zeros(3))))
    return read_motion(path)


def quat(turn: Rotation) -> Quat:
    x, y, z, w = turn.as_quat()
    return (float(w), float(x), float(y), float(z))


def rotation(turn: Quat) -> Rotation:
    w, x, y, z = turn
    return Rotation.from_quat([x, y, z, w])


def armature_of(
    bones: Bones, turn: Rotation, size: float, place_m: tuple[float, float, float], seed: int
) -> RestArmature:
    """Armature in metres over ``size``, whose bones have axes at random."""
    axes = Rotation.random(len(bones), rng=np.random.default_rng(seed))
    order = [name for name, (parent, *_) in bones.items() if parent is None]
    for name in order:  # It grows meanwhile.
        order += [child for child, (parent, *_) in bones.items() if parent == name]
    return RestArmature(
        {
            name: RestBone(bones[name][0], tuple((bones[name][1] / size).tolist()), quat(axes[number]))
            for number, name in enumerate(order)
        },
        place_m,
        quat(turn),
        size,
    )


def played(armature: RestArmature, mapped: BoneMap, motion: PersonMotion) -> list[tuple[Posed, dict[str, Rotation]]]:
    """Heads (metres) and axes of all bones in the world in each frame, posed as Blender poses."""
    frames = []
    hips = mapped.bones["Hips"]
    world, rest = rotation(armature.turn), {name: rotation(bone.axes) for name, bone in armature.bones.items()}
    for pose in Retargeting(motion, armature, mapped).frames():
        heads: Posed = {}
        axes: dict[str, Rotation] = {}
        for name, bone in armature.bones.items():
            own = rotation(pose.turns[name]) if name in pose.turns else Rotation.identity()
            shift = np.array(pose.hips) if name == hips else np.zeros(3)
            if bone.parent is None:
                heads[name], axes[name] = np.array(bone.head) + rest[name].apply(shift), rest[name] * own
            else:
                from_parent = rest[bone.parent].inv()
                offset = from_parent.apply(np.array(bone.head) - armature.bones[bone.parent].head)
                offset = offset + from_parent.apply(rest[name].apply(shift))
                heads[name] = heads[bone.parent] + axes[bone.parent].apply(offset)
                axes[name] = axes[bone.parent] * from_parent * rest[name] * own
        frames.append(
            (
                {name: np.array(armature.place_m) + world.apply(armature.size * head) for name, head in heads.items()},
                {name: world * turn for name, turn in axes.items()},
            )
        )
    return frames


RIGS = ("default", "mixamo", "game_engine")
PLACES = (
    ((0.0, 0.0, 0.0), 1.0, (0.0, 0.0, 0.0)),
    ((90.0, 0.0, 0.0), 0.01, (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 130.0), 1.3, (4.0, 2.0, 0.0)),
)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1.0, 1.0))))


# Each rig stands in a way of its own in the quick run.
@pytest.mark.parametrize(
    ("rig", "turn_deg", "size", "place_m"),
    slow_but(
        [(rig, *place) for rig, place in zip(RIGS, PLACES, strict=True)],
        [(rig, *place) for rig in RIGS for place in PLACES],
    ),
)
def test_limbs_point_as_person_s(
    motion: PersonMotion,
    rig: str,
    turn_deg: tuple[float, float, float],
    size: float,
    place_m: tuple[float, float, float],
) -> None:
    turn = Rotation.from_euler("xyz", turn_deg, degrees=True)
    bones = bones_of(rig)
    if turn_deg[0]:  # A rig with Y up, which the armature's rotation stands up.
        bones = {name: (parent, turn.inv().apply(a), turn.inv().apply(b)) for name, (parent, a, b) in bones.items()}
    armature = armature_of(bones, turn, size, place_m, seed=7)
    mapped = add_trunk(read_tree(rig), recognise_bones(read_tree(rig)))
    for frame, (heads, _) in enumerate(played(armature, mapped, motion)):
        person = posed_m(motion, frame)
        for above, below in (pair for limb in LIMBS for pair in pairwise(limb)):
            own = heads[mapped.bones[below]] - heads[mapped.bones[above]]
            assert angle_deg(own, person[below] - person[above]) < 0.1, (frame, below)
        for finger in ("Index", "Pinky"):
            above, below = f"LeftHand{finger}1", f"LeftHand{finger}2"
            own = heads[mapped.bones[below]] - heads[mapped.bones[above]]
            assert angle_deg(own, person[below] - person[above]) < 0.1, (frame, below)


def test_hips_and_feet_go_as_far_as_legs_are_long(motion: PersonMotion) -> None:
    size = 1.5
    armature = armature_of(bones_of("mixamo"), Rotation.identity(), size, (0.0, 0.0, 0.0), seed=1)
    larger = {name: (bone.head, bone) for name, bone in armature.bones.items()}
    # The armature is half as large again: its heads were divided by its size before.
    armature = RestArmature(
        {
            name: RestBone(bone.parent, (head[0] * size, head[1] * size, head[2] * size), bone.axes)
            for name, (head, bone) in larger.items()
        },
        (0.0, 0.0, 0.0),
        armature.turn,
        size,
    )
    mapped = add_trunk(read_tree("mixamo"), recognise_bones(read_tree("mixamo")))
    rest = {joint: np.array(armature.head_m(bone)) for joint, bone in mapped.bones.items()}
    leg_m = sum(np.linalg.norm(rest[a] - rest[b]) for a, b in pairwise(("LeftUpLeg", "LeftLeg", "LeftFoot")))
    person = [posed_m(motion, frame) for frame in range(motion.num_frames)]
    own_m = sum(np.linalg.norm(person[0][a] - person[0][b]) for a, b in pairwise(("LeftUpLeg", "LeftLeg", "LeftFoot")))
    heads = [heads for heads, _ in played(armature, mapped, motion)]
    ratio = leg_m / own_m
    assert ratio > 1.2
    hips = [sum(place[mapped.bones[f"{side}UpLeg"]] for side in ("Left", "Right")) / 2 for place in heads]
    own = [(place["LeftUpLeg"] + place["RightUpLeg"]) / 2 for place in person]
    np.testing.assert_allclose(hips[-1] - hips[0], ratio * (own[-1] - own[0]), atol=1e-3)
    # Ankles are as high over the person's as the shoes of the rest pose make them, up to the share of thigh and shin.
    rest_m = Retargeting(motion, armature, mapped)._rest_m
    for frame, place in enumerate(heads):
        lift_m = rest["LeftFoot"][2] - ratio * rest_m["LeftFoot"][2]
        expected_m = ratio * person[frame]["LeftFoot"][2] + lift_m
        assert place[mapped.bones["LeftFoot"]][2] == pytest.approx(expected_m, abs=0.02)


def test_bones_without_joint_stay_at_rest(motion: PersonMotion) -> None:
    armature = armature_of(bones_of("default"), Rotation.identity(), 1.0, (0.0, 0.0, 0.0), seed=3)
    mapped = add_trunk(read_tree("default"), recognise_bones(read_tree("default")))
    pose = next(Retargeting(motion, armature, mapped).frames())
    toes = {mapped.bones[f"{side}ToeBase"] for side in ("Left", "Right")}  # They do not bend.
    assert set(pose.turns) == {*mapped.bones.values(), *mapped.spine, *mapped.neck} - toes


def test_person_at_rest_leaves_t_pose(motion: PersonMotion) -> None:
    """A figure with the person's own bones takes the person's pose exactly."""
    turns = {joint: [(1.0, 0.0, 0.0, 0.0)] for joint in motion.turns}
    still = PersonMotion(motion.frame_rate_hz, motion.parents, motion.offsets_m, [motion.offsets_m["Hips"]], turns)
    rest = posed_m(still, 0)
    bones: Bones = {joint: (parent, rest[joint], rest[joint]) for joint, parent in motion.parents.items()}
    armature = armature_of(bones, Rotation.identity(), 1.0, (0.0, 0.0, 0.0), seed=5)
    mapped = BoneMap(
        {joint: joint for joint in bones if joint not in {"Spine", "Chest", "Neck"} and not joint.endswith("End")},
        ("Spine", "Chest"),
        ("Neck",),
    )
    pose = next(Retargeting(still, armature, mapped).frames())
    assert np.linalg.norm(pose.hips) < 1e-9
    assert all(abs(turn[0]) > 1.0 - 1e-9 for turn in pose.turns.values())
    moving = played(armature, mapped, motion)
    for frame in (0, 29):
        person = posed_m(motion, frame)
        for joint, place in moving[frame][0].items():
            np.testing.assert_allclose(place, person[joint], atol=1e-6, err_msg=joint)


def test_legs_without_length_are_refused(motion: PersonMotion, tmp_path: Path) -> None:
    bones = {name: (parent, np.zeros(3), np.zeros(3)) for name, (parent, *_) in bones_of("mixamo").items()}
    mapped = add_trunk(read_tree("mixamo"), recognise_bones(read_tree("mixamo")))
    with pytest.raises(RequestError, match="no length"):
        Retargeting(motion, armature_of(bones, Rotation.identity(), 1.0, (0.0, 0.0, 0.0), seed=1), mapped)
