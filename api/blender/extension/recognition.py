"""Bones of the armature that the user chose, in the panel's list."""

from collections.abc import Mapping
from typing import Any

from api.blender.extension import characters
from api.blender.extension.bone_tree import problems_of, recognised
from api.blender.extension.work import say
from pipeline.export.character.bone_names import HIPS, OPTIONAL, REQUIRED

_JOINTS = (HIPS, *REQUIRED, *OPTIONAL)


def recognise(state: Any) -> None:
    """Fill the list of bones with those that names tell."""
    show_bones(state, recognised(characters.tree_of(state.armature)))


def stated_bones(state: Any) -> dict[str, str]:
    """Bones by joint of the list."""
    return {item.joint: item.bone for item in state.bones if item.bone}


def show_bones(state: Any, found: Mapping[str, str]) -> None:
    """Fill the list of bones, and say what is missing. Bones that the armature lacks are left out."""
    tree = characters.tree_of(state.armature)
    bones = {joint: bone for joint, bone in found.items() if joint in _JOINTS and bone in tree.names}
    state.bones.clear()
    for joint in _JOINTS:
        item = state.bones.add()
        item.name, item.joint, item.bone = joint, joint, bones.get(joint, "")
    problems = problems_of(tree, bones)
    say(" ".join(problems) if problems else f"{len(bones)} joints of the body have bones.", is_error=bool(problems))
