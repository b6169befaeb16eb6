"""Corrections of a person's joints: parts of the body that they name. Standard library only."""

from collections.abc import Collection, Sequence
from typing import get_args

from pipeline.core.joints import FINGER_JOINTS
from pipeline.core.options.edits import Limb, Sides

_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")
_PARTS = {
    **{f"{side}_arm": tuple(f"{side}_{kind}" for kind in _ARM) for side in ("left", "right")},
    **{f"{side}_leg": tuple(f"{side}_{kind}" for kind in _LEG) for side in ("left", "right")},
    "head": ("nose", "left_eye", "right_eye", "left_ear", "right_ear"),
}
PARTS = ("all", *_PARTS)
"""Parts of a body that stand for their joints."""


def joints_of_part(part: str, names: Sequence[str]) -> list[str]:
    """Joints of a set that a part of the body, or the name of a joint, stands for; fingers belong to their arm."""
    if part == "all":
        return list(names)
    of_part: Collection[str] = _PARTS.get(part, (part,))
    side = part.removesuffix("_arm")
    fingers = [name for name in names if name in FINGER_JOINTS and part.endswith("_arm") and name.startswith(side)]
    return [name for name in names if name in of_part] + fingers


def joints_of_sides(part: Sides, names: Sequence[str]) -> list[str]:
    """Joints of a set whose sides are exchanged."""
    if part == "all":
        return list(names)
    return [name for side in ("left", "right") for name in joints_of_part(f"{side}_{part.removesuffix('s')}", names)]


LIMBS: tuple[Limb, ...] = get_args(Limb)
"""All hands and feet."""
