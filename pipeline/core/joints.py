"""Joint sets of detectors: joint names in the detector's order, and the bones between them."""

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class JointSet:
    """Joints of a detector and the bones between them."""

    names: tuple[str, ...]  # Names of the joints, in the order of the arrays' joint axis
    bones: tuple[tuple[str, str], ...]  # Pairs of joint names, for drawing and for bone lengths

    def index(self, name: str) -> int:
        """Position of a joint on the joint axis; ``ValueError`` if the set has no such joint."""
        return self.names.index(name)

    def indices(self, names: tuple[str, ...]) -> list[int]:
        """Positions of joints on the joint axis; ``ValueError`` if the set lacks a joint."""
        return [self.names.index(name) for name in names]


@dataclass(frozen=True, slots=True)
class JointOffset:
    """Offset of a detector's mark from the centre of a joint, in metres for each metre of the trunk's length.

    The trunk reaches from the centre between the hips to the centre between the shoulders.
    """

    # Component away from the body's middle, 0 for joints without a side; to the front; and up along the body. Axes are
    # the axes of the part of the body; see ``pipeline.motion.skeleton.marks``.
    outwards: float = 0.0
    forward: float = 0.0
    up: float = 0.0


JointOffsets = Mapping[str, JointOffset]
"""Offsets by kind of joint: the name without the side. A joint that is not named is marked at its centre."""
MARKED_AT_CENTERS: JointOffsets = {}
"""Offsets of a detector that marks every joint at its centre."""

COCO_17 = JointSet(
    names=(
        "nose",
        "left_eye",
        "right_eye",
        "left_ear",
        "right_ear",
        "left_shoulder",
        "right_shoulder",
        "left_elbow",
        "right_elbow",
        "left_wrist",
        "right_wrist",
        "left_hip",
        "right_hip",
        "left_knee",
        "right_knee",
        "left_ankle",
        "right_ankle",
    ),
    bones=(
        ("nose", "left_eye"),
        ("nose", "right_eye"),
        ("left_eye", "left_ear"),
        ("right_eye", "right_ear"),
        ("left_shoulder", "right_shoulder"),
        ("left_shoulder", "left_elbow"),
        ("right_shoulder", "right_elbow"),
        ("left_elbow", "left_wrist"),
        ("right_elbow", "right_wrist"),
        ("left_shoulder", "left_hip"),
        ("right_shoulder", "right_hip"),
        ("left_hip", "right_hip"),
        ("left_hip", "left_knee"),
        ("right_hip", "right_knee"),
        ("left_knee", "left_ankle"),
        ("right_knee", "right_ankle"),
    ),
)

SIDES = ("left", "right")
_OTHER = {"left": "right", "right": "left"}


def other_side(name: str) -> str:
    """Name of the joint on the other side of the body; the name itself of a joint without a side."""
    side, _, part = name.partition("_")
    return f"{_OTHER[side]}_{part}" if side in _OTHER else name


_HEELS_AND_TOES = tuple((f"{side}_ankle", f"{side}_{part}") for part in ("heel", "big_toe") for side in SIDES)
BODY_FEET = JointSet(
    names=(*COCO_17.names, *(name for _, name in _HEELS_AND_TOES)),
    bones=(*COCO_17.bones, *_HEELS_AND_TOES),
)
"""COCO's joints, then heels and big toes."""

FINGERS: Mapping[str, tuple[str, str, str, str]] = {
    "thumb": ("cmc", "mcp", "ip", "tip"),
    **dict.fromkeys(("index", "middle", "ring", "pinky"), ("mcp", "pip", "dip", "tip")),
}
"""Joints of each finger from the palm to the tip: carpometacarpal, metacarpophalangeal, interphalangeal."""


def finger_joints(side: str) -> tuple[str, ...]:
    """Names of the 20 joints of a hand's fingers, thumb first, each from the palm to the tip."""
    return tuple(f"{side}_{finger}_{joint}" for finger, joints in FINGERS.items() for joint in joints)


def hand_bones(side: str) -> tuple[tuple[str, str], ...]:
    """Bones of a hand: along each finger from the wrist."""
    chains = ((f"{side}_wrist", *(f"{side}_{finger}_{joint}" for joint in FINGERS[finger])) for finger in FINGERS)
    return tuple(bone for chain in chains for bone in itertools.pairwise(chain))


FINGER_JOINTS = frozenset(name for side in SIDES for name in finger_joints(side))
"""Names of the joints of all fingers; the wrist belongs to the body."""

WHOLE_BODY = JointSet(
    names=(*BODY_FEET.names, *finger_joints("left"), *finger_joints("right")),
    bones=(*BODY_FEET.bones, *hand_bones("left"), *hand_bones("right")),
)
"""Joints of ``BODY_FEET``, then the fingers of the left and of the right hand."""


@functools.cache
def without_hands(joints: JointSet) -> JointSet:
    """Joints of a set that belong to no finger, in the same order."""
    return JointSet(
        names=tuple(name for name in joints.names if name not in FINGER_JOINTS),
        bones=tuple(bone for bone in joints.bones if FINGER_JOINTS.isdisjoint(bone)),
    )


_OPENPOSE_BONES = (*COCO_17.bones, ("nose", "neck"))
_OPENPOSE_FEET = tuple(
    bone
    for side in ("left", "right")
    for bone in (
        (f"{side}_ankle", f"{side}_heel"),
        (f"{side}_ankle", f"{side}_big_toe"),
        (f"{side}_big_toe", f"{side}_small_toe"),
    )
)

# Joints of OpenPose's models BODY_25 and COCO, in the order of its output.
BODY_25 = JointSet(
    names=(
        "nose",
        "neck",
        "right_shoulder",
        "right_elbow",
        "right_wrist",
        "left_shoulder",
        "left_elbow",
        "left_wrist",
        "mid_hip",
        "right_hip",
        "right_knee",
        "right_ankle",
        "left_hip",
        "left_knee",
        "left_ankle",
        "right_eye",
        "left_eye",
        "right_ear",
        "left_ear",
        "left_big_toe",
        "left_small_toe",
        "left_heel",
        "right_big_toe",
        "right_small_toe",
        "right_heel",
    ),
    bones=(*_OPENPOSE_BONES, ("neck", "mid_hip"), *_OPENPOSE_FEET),
)
COCO_18 = JointSet(
    names=tuple(name for name in BODY_25.names[:19] if name != "mid_hip"),
    bones=_OPENPOSE_BONES,
)

# Bones whose length is constant for a person: upper arms, forearms, thighs and shins.
LIMBS: tuple[tuple[str, str], ...] = (
    ("left_shoulder", "left_elbow"),
    ("right_shoulder", "right_elbow"),
    ("left_elbow", "left_wrist"),
    ("right_elbow", "right_wrist"),
    ("left_hip", "left_knee"),
    ("right_hip", "right_knee"),
    ("left_knee", "left_ankle"),
    ("right_knee", "right_ankle"),
)
