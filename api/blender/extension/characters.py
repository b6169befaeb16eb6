"""Armatures of the scene: their bones, and actions on them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import bpy
from mathutils import Quaternion

from api.blender.extension.answers import RequestError
from api.blender.extension.bone_tree import BoneMap, BoneTree, add_trunk, bone_problems, recognise_bones
from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.retarget import RestArmature, RestBone, Retargeting, rest_joints_m
from api.blender.extension.scene import object_mode, scene_rate_hz
from api.blender.extension.turns import length, plus, scaled
from api.blender.extension.work import say
from pipeline.export.character.bone_names import HIPS, OPTIONAL, REQUIRED

_JOINTS = (HIPS, *REQUIRED, *OPTIONAL)
_FRAMES_A_STEP = 25
# Difference between the axes of the scale of an armature, as a share.
_EVEN = 1e-3


def find_armature(name: str) -> Any:
    """Armature of the scene of this name; ``None`` if there is none."""
    thing = bpy.data.objects.get(name)
    return thing if thing is not None and thing.type == "ARMATURE" else None


def read_tree(armature: Any) -> BoneTree:
    """Bones of an armature as a tree."""
    bones = list(armature.data.bones)
    numbers = {bone.name: number for number, bone in enumerate(bones)}
    return BoneTree(tuple(numbers), tuple(-1 if bone.parent is None else numbers[bone.parent.name] for bone in bones))


def read_rest(armature: Any) -> RestArmature:
    """Rest pose of an armature. Raises ``RequestError`` if its scale is uneven or 0."""
    place, turn, scale = armature.matrix_world.decompose()
    if min(scale) <= 0.0 or max(scale) - min(scale) > _EVEN * max(scale):
        raise RequestError(f"The scale of {armature.name} is uneven or mirrored. Apply it: Object, Apply, Scale.")
    tree = read_tree(armature)
    bones = [armature.data.bones[tree.names[number]] for number in tree.bones]
    return RestArmature(
        {
            bone.name: RestBone(
                None if bone.parent is None else bone.parent.name,
                tuple(bone.head_local),
                tuple(bone.matrix_local.to_quaternion()),
                bone.use_inherit_rotation,
            )
            for bone in bones
        },
        tuple(place),
        tuple(turn),
        sum(scale) / len(scale),
    )


def constrained(armature: Any, bones: Sequence[str]) -> list[str]:
    """Bones of some that constraints pull out of the pose of an action."""
    return [
        bone
        for bone in bones
        if any(not item.mute and item.influence > 0.0 for item in armature.pose.bones[bone].constraints)
    ]


def check_bones(armature: Any, bones: Mapping[str, str]) -> None:
    """Raise ``RequestError`` if motion can't be put on these bones."""
    problems = bone_problems(read_tree(armature), bones)
    if problems:
        raise RequestError(" ".join(problems))
    if armature.data.bones[bones[HIPS]].use_connect:
        raise RequestError(
            f"The bone {bones[HIPS]} can't move away from its parent. Switch off Connected in edit mode."
        )


def to_rest(armature: Any) -> None:
    """Give all bones their rest pose, and rotations as quaternions."""
    for bone in armature.pose.bones:
        bone.matrix_basis.identity()
        bone.location, bone.scale, bone.rotation_mode = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), "QUATERNION"
        bone.rotation_quaternion, bone.rotation_euler = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def put_on(armature: Any, motion: PersonMotion, name: str, first_frame: int = 0) -> Iterator[float]:
    """Put the motion of a person on an armature, as a new action; yield the share that is done, now and then.

    ``first_frame``: frame of the scene that has the first pose; other frame rates of the scene keep the time. The
    action that the armature had before stays in the file. Raises ``RequestError`` if bones are missing.
    """
    armature_name, bones = armature.name, known_bones(armature)
    check_bones(armature, bones)
    mapped: BoneMap = add_trunk(read_tree(armature), bones)
    poses = Retargeting(motion, read_rest(armature), mapped)
    hips, frames_a_key = bones[HIPS], scene_rate_hz(bpy.context.scene) / motion.frame_rate_hz
    turns: dict[str, list[float]] = {}
    places: list[float] = []
    before: dict[str, Quaternion] = {}
    for number, pose in enumerate(poses.frames()):
        for bone, turn in pose.turns.items():
            key = Quaternion(turn)
            # Keys of a curve have the sign of those before, so that it does not swing round between them.
            if bone in before and before[bone].dot(key) < 0.0:
                key.negate()
            before[bone] = key
            turns.setdefault(bone, []).extend(key)
        places.extend(pose.hips)
        if number % _FRAMES_A_STEP == 0:
            yield number / motion.num_frames
    # An undo meanwhile replaces all objects of Blender: the armature is found by its name again.
    armature = find_armature(armature_name)
    if armature is None:
        raise RequestError(f"The armature {armature_name} is no longer there.")
    action, curves = _new_action(armature, name)
    to_rest(armature)
    for bone, values in turns.items():
        path = f'pose.bones["{bpy.utils.escape_identifier(bone)}"].rotation_quaternion'
        for axis in range(4):
            _add_curve(curves, path, axis, values[axis::4], first_frame, frames_a_key)
    path = f'pose.bones["{bpy.utils.escape_identifier(hips)}"].location'
    for axis in range(3):
        _add_curve(curves, path, axis, places[axis::3], first_frame, frames_a_key)
    action.use_fake_user = True
    yield 1.0


def _new_action(armature: Any, name: str) -> tuple[Any, Any]:
    """New action of an armature, and the collection of its curves, whichever way this version of Blender keeps them."""
    data = armature.animation_data or armature.animation_data_create()
    action = bpy.data.actions.new(name)
    data.action = action
    if hasattr(action, "fcurves"):
        return action, action.fcurves
    slot = action.slots.new(id_type="OBJECT", name=armature.name)
    data.action_slot = slot
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return action, strip.channelbag(slot, ensure=True).fcurves


def _add_curve(
    curves: Any, path: str, axis: int, values: Sequence[float], first_frame: int, frames_a_key: float
) -> None:
    curve = curves.new(path, index=axis)
    curve.keyframe_points.add(len(values))
    pairs = [number for frame, value in enumerate(values) for number in (first_frame + frame * frames_a_key, value)]
    curve.keyframe_points.foreach_set("co", pairs)
    curve.keyframe_points.foreach_set("interpolation", [1] * len(values))  # Linear
    curve.update()


def add_armature(name: str, rest: PersonMotion) -> Any:
    """Add a simple armature with the bones of a person to the scene; bones bear the names of their joints."""
    heads_m = rest_joints_m(rest)
    above = {joint: parent for joint, parent in rest.parents.items() if parent is None or length(rest.offsets_m[joint])}
    below: dict[str, list[str]] = {}
    for joint, nearest in above.items():
        parent = nearest
        while parent is not None and parent not in above:  # a bone that the sender lacks
            parent = rest.parents[parent]
        above[joint] = parent
        below.setdefault(parent or "", []).append(joint)
    data = bpy.data.armatures.new(name)
    armature = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(armature)
    with object_mode():
        objects = bpy.context.view_layer.objects
        active, objects.active = objects.active, armature
        bpy.ops.object.mode_set(mode="EDIT")
        for joint, parent in above.items():
            bone = data.edit_bones.new(joint)
            bone.parent = None if parent is None else data.edit_bones[parent]
            bone.head = heads_m[joint]
            ends = below.get(joint, ())
            end = next((child for child in ends if "Middle" in child), next(iter(ends), None))
            bone.tail = plus(heads_m[joint], scaled(rest.offsets_m[joint], 0.4)) if end is None else heads_m[end]
        bpy.ops.object.mode_set(mode="OBJECT")
        objects.active = active
    return armature


_stated: dict[str, dict[str, str]] = {}
"""Bones by joint of the lists that were shown, by the name of the armature."""


def known_bones(armature: Any) -> dict[str, str]:
    """Bones by joint that the user has chosen for an armature; without a choice those that names tell."""
    return _stated.get(armature.name) or recognise_bones(read_tree(armature))


def recognise(state: Any) -> None:
    """Fill the list of bones with those that names tell."""
    show_bones(state, recognise_bones(read_tree(find_armature(state.armature))))


def stated_bones(state: Any) -> dict[str, str]:
    """Bones by joint of the list, which are known from now on."""
    _stated[state.armature] = {item.joint: item.bone for item in state.bones if item.bone}
    return _stated[state.armature]


def show_bones(state: Any, found: Mapping[str, str]) -> None:
    """Fill the list of bones, and say what is missing. Bones that the armature lacks are left out."""
    tree = read_tree(find_armature(state.armature))
    bones = {joint: bone for joint, bone in found.items() if joint in _JOINTS and bone in tree.names}
    state.bones.clear()
    for joint in _JOINTS:
        item = state.bones.add()
        item.name, item.joint, item.bone = joint, joint, bones.get(joint, "")
    problems = bone_problems(tree, bones)
    say(" ".join(problems) if problems else f"{len(bones)} joints of the body have bones.", is_error=bool(problems))
