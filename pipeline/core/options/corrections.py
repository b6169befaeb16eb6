"""Corrections of a person's joints, put right by hand. Standard library only: the web API imports this module.

Corrections are data. Frames are numbered as in the reconstruction; ``stop_frame`` is the frame after the last one.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from pipeline.core.joints import FINGER_JOINTS

Sides = Literal["arms", "legs", "all"]
"""Joints of both sides that are exchanged."""
Limb = Literal["left_hand", "right_hand", "left_foot", "right_foot"]
"""Hand or foot that touches the floor."""

MAX_KEY_M = 2.0
"""Largest distance in metres by which a key moves a joint."""

_ARM, _LEG = ("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle", "heel", "big_toe", "small_toe")
_PARTS = {
    **{f"{side}_arm": tuple(f"{side}_{kind}" for kind in _ARM) for side in ("left", "right")},
    **{f"{side}_leg": tuple(f"{side}_{kind}" for kind in _LEG) for side in ("left", "right")},
    "head": ("nose", "left_eye", "right_eye", "left_ear", "right_ear"),
}
PARTS = ("all", *_PARTS)
"""Parts of a body that stand for their joints."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """Put a joint of a person at a place in the world in one frame."""

    joint: str
    frame: int
    place_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IgnoreDetections:
    """Ignore what a camera sees of a person: of a joint, of a part of the body, or of ``all``."""

    camera: str
    part: str
    start_frame: int
    stop_frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceDetection:
    """Put the detection of a joint to a place in a camera's picture in one frame: distorted pixels, as seen."""

    camera: str
    joint: str
    frame: int
    place_px: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExchangeSides:
    """Exchange the left and the right side of a person in all cameras."""

    part: Sides
    start_frame: int
    stop_frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Let a foot or a hand stand on the floor, or not."""

    limb: Limb
    start_frame: int
    stop_frame: int
    stands: bool


Correction = Key | IgnoreDetections | PlaceDetection | ExchangeSides | Contact
"""A correction of a person."""


def first_and_last(correction: Correction) -> tuple[int, int]:
    """First and last frame of a correction."""
    if isinstance(correction, Key | PlaceDetection):
        return correction.frame, correction.frame
    return correction.start_frame, correction.stop_frame - 1


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
