"""Joints that move a body: the skeleton's, with fingers, then the twist joints of the forearms.

Between the elbow and the wrist the skin turns with the bones below it, the more the nearer to the wrist. A twist joint
lies on a forearm, is turned about it by a share of the hand's twist, and moves the skin around it. So the forearm keeps
its girth while the hand turns.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON, parent_indices

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
    """Rotations (x, y, z, w) of a twist joint from the skeleton's rotations, each frame by itself."""
    hand = parent_from_joint[:, INDEX[twist.hand]]
    angle_rad = 2.0 * np.arctan2(hand[:, 0], hand[:, 3])
    angle_rad = (angle_rad - MIDDLE_TWIST_RAD + np.pi) % (2.0 * np.pi) - np.pi + MIDDLE_TWIST_RAD
    half_rad = 0.5 * twist.share * angle_rad
    quat = np.zeros((len(hand), 4))
    quat[:, 0], quat[:, 3] = np.sin(half_rad), np.cos(half_rad)
    return quat


def blend(
    vertices: Float[np.ndarray, "vertices 3"],
    carriers: Int[np.ndarray, "vertices influences"],
    weights: Float[np.ndarray, "vertices influences"],
    moved_from_rest: Float[np.ndarray, "joints 3 4"],
) -> Float[np.ndarray, "vertices 3"]:
    """Move vertices by the weighted mean of the affine maps of the joints that carry them."""
    maps = np.einsum("vi,vixy->vxy", weights, moved_from_rest[carriers])
    return (maps[..., :3] @ vertices[..., None])[..., 0] + maps[..., 3]


def about(
    matrices: Float[np.ndarray, "joints 3 3"],
    rest: Float[np.ndarray, "joints 3"],
    places: Float[np.ndarray, "joints 3"],
) -> Float[np.ndarray, "joints 3 4"]:
    """Affine maps that apply matrices about the joints at rest, and bring the joints to places."""
    return np.concatenate([matrices, (places - (matrices @ rest[..., None])[..., 0])[..., None]], axis=-1)


def placed(
    turns: Float[np.ndarray, "joints 3 3"], rest_m: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "joints 3"]:
    """Positions of a skeleton's joints and then of its twist joints, by their orientations; the root stays in place."""
    num_joints = len(turns) - len(TWIST_JOINTS)
    parents = [*parent_indices(num_joints), *(INDEX[twist.parent] for twist in TWIST_JOINTS)]
    places_m = rest_m.copy()
    for joint, parent in enumerate(parents[1:], 1):
        places_m[joint] = places_m[parent] + turns[parent] @ (rest_m[joint] - rest_m[parent])
    return places_m


def world_from_joints(
    parent_from_joint: Float[np.ndarray, "joints 4"],
) -> Float[np.ndarray, "all_joints 3 3"]:
    """Orientations of a skeleton's joints and then of its twist joints, from the rotations of one frame."""
    num_joints = len(parent_from_joint)
    own = Rotation.from_quat(parent_from_joint).as_matrix()
    world = np.empty((num_joints + len(TWIST_JOINTS), 3, 3))
    for joint, parent in enumerate(parent_indices(num_joints)):
        world[joint] = world[parent] @ own[joint] if joint else own[joint]
    for number, twist in enumerate(TWIST_JOINTS, num_joints):
        turn = Rotation.from_quat(twist_quat(parent_from_joint[None], twist)[0])
        world[number] = world[INDEX[twist.parent]] @ turn.as_matrix()
    return world
