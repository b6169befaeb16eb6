"""Joints that move a body: those of the skeleton with fingers, then the twist joints of the forearms.

Between the elbow and the wrist the skin turns with the bones below it, the more the nearer to the wrist. A twist joint
lies on a forearm, is turned about it by a share of the hand's twist, and moves the skin around it. So the forearm keeps
its girth while the hand turns.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON

NUM_TWISTS = 3
"""Number of twist joints of a forearm."""

MIDDLE_TWIST_RAD = float(np.radians(-75.0))
"""Middle of the range of a hand's turns about the arm, whose rest pose is palm down. Palms turn up by the front: a
negative turn about +X on both sides."""


@dataclass(frozen=True, slots=True)
class TwistJoint:
    """Joint on a forearm that is turned about it by a share of the hand's twist."""

    name: str
    parent: str  # Name of the joint of the forearm
    hand: str  # Name of the joint whose twist is shared
    share: float  # Share of the twist, and of the way from the elbow to the wrist


TWIST_JOINTS: tuple[TwistJoint, ...] = tuple(
    TwistJoint(f"{side}ForeArmTwist{number}", f"{side}ForeArm", f"{side}Hand", number / (NUM_TWISTS + 1))
    for side in ("Left", "Right")
    for number in range(1, NUM_TWISTS + 1)
)
"""Twist joints of both forearms, each side from the elbow to the wrist."""

BODY_JOINTS: tuple[str, ...] = (
    *(joint.name for joint in WHOLE_SKELETON),
    *(twist.name for twist in TWIST_JOINTS),
)
"""Names of all joints that move a body."""

BODY_INDEX: Mapping[str, int] = MappingProxyType({name: number for number, name in enumerate(BODY_JOINTS)})
"""Position of each joint in ``BODY_JOINTS``."""


def twist_quat(
    parent_from_joint: Float[np.ndarray, "frames joints 4"], twist: TwistJoint
) -> Float[np.ndarray, "frames 4"]:
    """Rotations (x, y, z, w) of a twist joint from those of the skeleton's joints, each frame by itself."""
    hand = parent_from_joint[:, INDEX[twist.hand]]
    angle_rad = 2.0 * np.arctan2(hand[:, 0], hand[:, 3])
    angle_rad = (angle_rad - MIDDLE_TWIST_RAD + np.pi) % (2.0 * np.pi) - np.pi + MIDDLE_TWIST_RAD
    half_rad = 0.5 * twist.share * angle_rad
    quat = np.zeros((len(hand), 4))
    quat[:, 0], quat[:, 3] = np.sin(half_rad), np.cos(half_rad)
    return quat
