"""Bones of humanoids of game engines, by joint of the animation skeleton."""

from collections.abc import Mapping
from types import MappingProxyType

_TRUNK = ("Hips", "Spine", "Chest", "Neck", "Head")
_LIMBS = {
    "Shoulder": "Shoulder",
    "Arm": "UpperArm",
    "ForeArm": "LowerArm",
    "Hand": "Hand",
    "UpLeg": "UpperLeg",
    "Leg": "LowerLeg",
    "Foot": "Foot",
}

UNITY_BONES: Mapping[str, str] = MappingProxyType(
    {
        **{name: name for name in _TRUNK},
        **{f"{side}{joint}": f"{side}{bone}" for side in ("Left", "Right") for joint, bone in _LIMBS.items()},
    }
)
"""Bone of Unity's humanoid (``HumanBodyBones``) by joint, without fingers; ends of bones have none."""
