"""The animation skeleton: joints, parents, rest pose and forward kinematics.

The rest pose is a T-pose in world axes (Z up): the person stands upright, faces -Y, the left side points to +X and both
arms are stretched out along X, palms down. In the rest pose each joint's frame is aligned with the world axes, so all
rotations are the identity.

Shares of stature are from Drillis and Contini (1966) as printed in Winter, "Biomechanics and Motor Control of Human
Movement" (2009), fig. 4.1; shoulders and hips are at the joint centres, which are closer together than the printed
breadths.
"""

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.data import SkeletonMotion

_UP = (0.0, 0.0, 1.0)
_DOWN = (0.0, 0.0, -1.0)
_LEFT = (1.0, 0.0, 0.0)
_RIGHT = (-1.0, 0.0, 0.0)
# Direction from the ankle to the tip of the toes, which touch the floor.
_TOES = (0.0, -cos(radians(22.0)), -sin(radians(22.0)))

TRUNK = ("Spine", "Chest", "Neck")
"""Bones from the centre of the hips to the centre of the shoulders: 0.288 of stature."""
_TRUNK_SHARES = (0.058, 0.130, 0.100)


@dataclass(frozen=True, slots=True)
class SkeletonJoint:
    """Joint of the animation skeleton.

    Parameters
    ----------
    name
        Name as in animation software (Mixamo's names without the prefix). Ends of bones are called ``<Parent>End``.
    parent
        Name of the joint's parent; ``None`` for the root.
    rest_direction
        Unit vector from the parent to the joint in the rest pose, world axes.
    stature_share
        Length of the bone from the parent as a share of stature, for bones without a measured length.
    landmarks
        Joints of the detector whose mean is this joint's measured position; empty for derived joints.
    """

    name: str
    parent: str | None
    rest_direction: tuple[float, float, float]
    stature_share: float
    landmarks: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Name without the side."""
        return self.name.removeprefix("Left").removeprefix("Right")


def _arm(side: str, outwards: tuple[float, float, float]) -> tuple[SkeletonJoint, ...]:
    prefix = side.lower()
    return (
        # The collar bones begin at the base of the neck, so that their rest directions don't depend on the shoulder
        # width.
        SkeletonJoint(f"{side}Shoulder", "Chest", _UP, _TRUNK_SHARES[2], ("left_shoulder", "right_shoulder")),
        SkeletonJoint(f"{side}Arm", f"{side}Shoulder", outwards, 0.105, (f"{prefix}_shoulder",)),
        SkeletonJoint(f"{side}ForeArm", f"{side}Arm", outwards, 0.186, (f"{prefix}_elbow",)),
        SkeletonJoint(f"{side}Hand", f"{side}ForeArm", outwards, 0.146, (f"{prefix}_wrist",)),
        SkeletonJoint(f"{side}HandEnd", f"{side}Hand", outwards, 0.108),
    )


def _leg(side: str, outwards: tuple[float, float, float]) -> tuple[SkeletonJoint, ...]:
    prefix = side.lower()
    return (
        SkeletonJoint(f"{side}UpLeg", "Hips", outwards, 0.06, (f"{prefix}_hip",)),
        SkeletonJoint(f"{side}Leg", f"{side}UpLeg", _DOWN, 0.245, (f"{prefix}_knee",)),
        SkeletonJoint(f"{side}Foot", f"{side}Leg", _DOWN, 0.246, (f"{prefix}_ankle",)),
        SkeletonJoint(f"{side}FootEnd", f"{side}Foot", _TOES, 0.104),
    )


SKELETON: tuple[SkeletonJoint, ...] = (
    SkeletonJoint("Hips", None, _UP, 0.0, ("left_hip", "right_hip")),
    SkeletonJoint("Spine", "Hips", _UP, _TRUNK_SHARES[0]),
    SkeletonJoint("Chest", "Spine", _UP, _TRUNK_SHARES[1]),
    SkeletonJoint("Neck", "Chest", _UP, _TRUNK_SHARES[2], ("left_shoulder", "right_shoulder")),
    SkeletonJoint("Head", "Neck", _UP, 0.118, ("left_ear", "right_ear")),
    SkeletonJoint("HeadEnd", "Head", _UP, 0.064),
    *_arm("Left", _LEFT),
    *_arm("Right", _RIGHT),
    *_leg("Left", _LEFT),
    *_leg("Right", _RIGHT),
)
"""All joints, parents before their children, root first."""

INDEX: dict[str, int] = {joint.name: position for position, joint in enumerate(SKELETON)}
"""Position of each joint on the joint axis of a ``SkeletonMotion``."""

CHILDREN: dict[str, tuple[str, ...]] = {
    joint.name: tuple(child.name for child in SKELETON if child.parent == joint.name) for joint in SKELETON
}
"""Names of each joint's children; empty for the ends of bones."""


def rest_offsets_m(bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "joints 3"]:
    """Offsets of all joints from their parents in the rest pose, world axes; 0 for the root."""
    directions = np.array([joint.rest_direction for joint in SKELETON])
    return directions * bone_length_m[:, None]


def joint_pose(motion: SkeletonMotion, name: str) -> tuple[Float[np.ndarray, "frames 3"], Rotation]:
    """World position (metres) and orientation of a joint of ``SKELETON``; only its ancestors are computed."""
    joint = SKELETON[INDEX[name]]
    rotation = Rotation.from_quat(motion.parent_from_joint[:, INDEX[name]])
    if joint.parent is None:
        return motion.root_m, rotation
    parent_m, world_from_parent = joint_pose(motion, joint.parent)
    offset_m = motion.bone_length_m[INDEX[name]] * np.array(joint.rest_direction)
    return parent_m + world_from_parent.apply(offset_m), world_from_parent * rotation


def forward_kinematics(motion: SkeletonMotion) -> Float[np.ndarray, "frames joints 3"]:
    """World positions (metres) of all joints of ``SKELETON``, ends of bones included."""
    offsets_m = rest_offsets_m(motion.bone_length_m)
    positions_m = np.empty((len(motion.root_m), len(SKELETON), 3))
    world_from_joint: list[Rotation] = []
    for index, joint in enumerate(SKELETON):
        rotation = Rotation.from_quat(motion.parent_from_joint[:, index])
        if joint.parent is None:
            positions_m[:, index] = motion.root_m
            world_from_joint.append(rotation)
            continue
        parent = INDEX[joint.parent]
        positions_m[:, index] = positions_m[:, parent] + world_from_joint[parent].apply(offsets_m[index])
        world_from_joint.append(world_from_joint[parent] * rotation)
    return positions_m
