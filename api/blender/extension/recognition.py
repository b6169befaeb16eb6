"""Bones of the armature that the user chose."""

from typing import Any

from api.blender.extension import characters
from api.blender.extension.bone_tree import HIPS, OPTIONAL, REQUIRED, problems_of, recognised
from api.blender.extension.work import say


def recognise(state: Any) -> None:
    """Fill the list of bones with those that are recognised."""
    tree = characters.tree_of(state.armature)
    found = recognised(tree)
    state.bones.clear()
    for joint in (HIPS, *REQUIRED, *OPTIONAL):
        item = state.bones.add()
        item.name, item.joint, item.bone = joint, joint, found.get(joint, "")
    problems = problems_of(tree, found)
    say(" ".join(problems) if problems else f"{len(found)} joints of the body have bones.", is_error=bool(problems))
