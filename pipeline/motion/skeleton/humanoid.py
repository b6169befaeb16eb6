"""Bones of humanoids of game engines, by joint of the animation skeleton."""

from collections.abc import Mapping
from types import MappingProxyType

_TRUNK = ("Hips", "Spine", "Chest", "Neck", "Head")
_FINGERS = {"Pinky": "Little"} | {name: name for name in ("Thumb", "Index", "Middle", "Ring")}
_SIDED = {
    "Shoulder": "Shoulder",
    "Arm": "UpperArm",
    "ForeArm": "LowerArm",
    "Hand": "Hand",
    "UpLeg": "UpperLeg",
    "Leg": "LowerLeg",
    "Foot": "Foot",
    **{
        f"Hand{finger}{number}": f"{name}{part}"
        for finger, name in _FINGERS.items()
        for number, part in enumerate(("Proximal", "Intermediate", "Distal"), 1)
    },
}

UNITY_BONES: Mapping[str, str] = MappingProxyType(
    {
        **{name: name for name in _TRUNK},
        **{f"{side}{joint}": f"{side}{bone}" for side in ("Left", "Right") for joint, bone in _SIDED.items()},
    }
)
"""Bone of Unity's humanoid (``HumanBodyBones``) by joint; ends of bones have none."""
