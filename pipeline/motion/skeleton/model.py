"""The animation skeleton: joints, parents, rest pose and forward kinematics.

The rest pose is a T-pose in world axes (Z up): the person stands upright, faces -Y, the left side points to +X and both
arms are stretched out along X, palms down. In the rest pose each joint's frame is aligned with the world axes, so all
rotations are the identity.

Shares of stature are from Drillis and Contini (1966) as printed in Winter, "Biomechanics and Motor Control of Human
Movement" (2009), fig. 4.1; shoulders and hips are at the joint centres, which are closer together than the printed
breadths. Lengths of fingers are shares of the hand's length after Buchholz, Armstrong and Goldstein, "Anthropometric
data for describing the kinematics of the human hand" (1992).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, radians, sin
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import FINGERS
from pipeline.motion.skeleton.rotations import times

_UP = (0.0, 0.0, 1.0)
_DOWN = (0.0, 0.0, -1.0)
_LEFT = (1.0, 0.0, 0.0)
_RIGHT = (-1.0, 0.0, 0.0)
# Direction from the ankle to the tip of the toes, which touch the floor.
_TOES = (0.0, -cos(radians(22.0)), -sin(radians(22.0)))

TRUNK = ("Spine", "Chest", "Neck")
"""Bones from the centre of the hips to the centre of the shoulders: 0.288 of stature."""
_TRUNK_SHARES = (0.058, 0.130, 0.100)

# Length of the hand from the wrist to the tip of the middle finger.
_HAND_SHARE = 0.108
# Lengths of a finger's bones as shares of the hand's length: from the wrist to the finger's base, then to the tip.
_FINGER_SHARES = {
    "thumb": (0.14, 0.251, 0.196, 0.158),
    "index": (0.463, 0.245, 0.143, 0.097),
    "middle": (0.446, 0.266, 0.170, 0.108),
    "ring": (0.421, 0.244, 0.165, 0.107),
    "pinky": (0.414, 0.204, 0.117, 0.093),
}
# Directions from the wrist to the bases of the fingers, in degrees: to the front, so that bases are about 20 mm
# apart, and down.
_BASE_DEG = {
    "thumb": (40.0, 20.0),
    "index": (14.0, 0.0),
    "middle": (1.0, 0.0),
    "ring": (-12.0, 0.0),
    "pinky": (-24.0, 4.0),
}
# Direction of the thumb's bones, in the same angles; the other fingers continue the forearm.
_THUMB_DEG = (40.0, 20.0)


@dataclass(frozen=True, slots=True)
class SkeletonJoint:
    """Joint of the animation skeleton."""

    # Name as in animation software (Mixamo's names without the prefix). Ends of bones are called ``<Parent>End``.
    name: str
    parent: str | None  # Name of the joint's parent; ``None`` for the root
    rest_direction: tuple[float, float, float]  # Unit vector from the parent to the joint in the rest pose, world axes
    # Length of the bone from the parent as a share of stature, for bones without a measured length
    stature_share: float
    # Joints of the detector whose mean is this joint's measured position; empty for derived joints
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
        SkeletonJoint(f"{side}HandEnd", f"{side}Hand", outwards, _HAND_SHARE),
    )


def _in_front(outwards: tuple[float, float, float], forward_deg: float, down_deg: float) -> tuple[float, float, float]:
    """Unit vector that points outwards, turned to the front and then down."""
    forward, down = radians(forward_deg), radians(down_deg)
    return (outwards[0] * cos(forward) * cos(down), -sin(forward) * cos(down), -sin(down))


def _fingers(side: str, outwards: tuple[float, float, float]) -> tuple[SkeletonJoint, ...]:
    """Joints of a hand's fingers, thumb first, each from its base to its end."""
    joints = []
    for finger, landmarks in FINGERS.items():
        along = _in_front(outwards, *_THUMB_DEG) if finger == "thumb" else outwards
        base = f"{side}Hand{finger.capitalize()}"
        names = (f"{side}Hand", f"{base}1", f"{base}2", f"{base}3", f"{base}3End")
        for place, (landmark, share) in enumerate(zip(landmarks, _FINGER_SHARES[finger], strict=True)):
            joints.append(
                SkeletonJoint(
                    names[place + 1],
                    names[place],
                    along if place else _in_front(outwards, *_BASE_DEG[finger]),
                    round(_HAND_SHARE * share, 5),
                    (f"{side.lower()}_{finger}_{landmark}",),
                )
            )
    return tuple(joints)


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
"""Joints of a body without fingers, parents before their children, root first."""

WHOLE_SKELETON: tuple[SkeletonJoint, ...] = (*SKELETON, *_fingers("Left", _LEFT), *_fingers("Right", _RIGHT))
"""The 24 joints of ``SKELETON``, then 20 joints of the fingers of the left hand and 20 of the right hand."""

INDEX: Mapping[str, int] = MappingProxyType({joint.name: position for position, joint in enumerate(WHOLE_SKELETON)})
"""Position of each joint on the joint axis of a ``SkeletonMotion``, with and without fingers."""

_PARENTS = np.array([INDEX[joint.parent] if joint.parent else 0 for joint in WHOLE_SKELETON])


def find_skeleton(num_joints: int) -> tuple[SkeletonJoint, ...]:
    """Skeleton with a number of joints: ``SKELETON`` or ``WHOLE_SKELETON``.

    Raises ``ValueError`` if no skeleton has this number of joints.
    """
    for skeleton in (SKELETON, WHOLE_SKELETON):
        if len(skeleton) == num_joints:
            return skeleton
    raise ValueError(f"no skeleton has {num_joints} joints")


def parent_indices(num_joints: int) -> Int[np.ndarray, " joints"]:
    """Index of each joint's parent in the skeleton with a number of joints; 0 for the root."""
    return _PARENTS[: len(find_skeleton(num_joints))]


def child_names(num_joints: int) -> Mapping[str, tuple[str, ...]]:
    """Names of the children of each joint in the skeleton with a number of joints; empty for the ends of bones."""
    return _CHILDREN[len(find_skeleton(num_joints))]


def _children(skeleton: tuple[SkeletonJoint, ...]) -> Mapping[str, tuple[str, ...]]:
    return MappingProxyType(
        {joint.name: tuple(child.name for child in skeleton if child.parent == joint.name) for joint in skeleton}
    )


_CHILDREN = {len(skeleton): _children(skeleton) for skeleton in (SKELETON, WHOLE_SKELETON)}


def rest_offsets_m(bone_length_m: Float[np.ndarray, " joints"]) -> Float[np.ndarray, "joints 3"]:
    """Offsets of all joints from their parents in the rest pose, world axes; 0 for the root.

    Raises ``ValueError`` if no skeleton has this number of joints.
    """
    directions = np.array([joint.rest_direction for joint in find_skeleton(len(bone_length_m))])
    return directions * bone_length_m[:, None]


def joint_pose(motion: SkeletonMotion, name: str) -> tuple[Float[np.ndarray, "frames 3"], Rotation]:
    """World position (metres) and orientation of a joint of the motion; only its ancestors are computed."""
    joint = WHOLE_SKELETON[INDEX[name]]
    rotation = Rotation.from_quat(motion.parent_from_joint[:, INDEX[name]])
    if joint.parent is None:
        return motion.root_m, rotation
    parent_m, world_from_parent = joint_pose(motion, joint.parent)
    offset_m = motion.bone_length_m[INDEX[name]] * np.array(joint.rest_direction)
    return parent_m + world_from_parent.apply(offset_m), world_from_parent * rotation


def forward_kinematics(motion: SkeletonMotion) -> Float[np.ndarray, "frames joints 3"]:
    """World positions (metres) of all joints of the motion's skeleton, ends of bones included."""
    return posed_joints(motion)[0]


def posed_joints(
    motion: SkeletonMotion,
) -> tuple[Float[np.ndarray, "frames joints 3"], list[Float[np.ndarray, "frames 3 3"]]]:
    """World positions (metres) of all joints of the motion's skeleton, and the rotation of each from the T-pose."""
    skeleton = find_skeleton(len(motion.bone_length_m))
    offsets_m = rest_offsets_m(motion.bone_length_m)
    positions_m = np.empty((len(motion.root_m), len(skeleton), 3))
    # Matrices: a product of SciPy's rotations takes ten times as long.
    quat = np.moveaxis(motion.parent_from_joint, 1, 0)
    parent_from_joint = Rotation.from_quat(quat.reshape(-1, 4)).as_matrix().reshape(*quat.shape[:2], 3, 3)
    world_from_joint: list[Float[np.ndarray, "frames 3 3"]] = []
    for index, joint in enumerate(skeleton):
        if joint.parent is None:
            positions_m[:, index] = motion.root_m
            world_from_joint.append(parent_from_joint[index])
            continue
        parent = INDEX[joint.parent]
        positions_m[:, index] = positions_m[:, parent] + times(world_from_joint[parent], offsets_m[index])
        world_from_joint.append(world_from_joint[parent] @ parent_from_joint[index])
    return positions_m, world_from_joint
