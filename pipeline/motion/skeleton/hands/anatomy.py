"""Anatomy of a hand for the fit: joints, hinges with limits, and the natural pose.

The wrist turns about three axes. The base of each finger has two hinges, spread and bend, and its other two joints have
one hinge each, which never bends backwards. The hand's axes are the skeleton's at rest: palms down, thumbs to
-Y. Ranges are rounded from the American Academy of Orthopaedic Surgeons ("Joint Motion", 1965).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side
from pipeline.core.joints import FINGERS
from pipeline.motion.skeleton.fitting.articulation import Articulation, Carried, Freedom, build
from pipeline.motion.skeleton.model import INDEX, WHOLE_SKELETON

HINGES = 4
"""Hinges of a finger: spread and bend of its base, and the bends of its two other joints."""
NUM_HINGES = HINGES * len(FINGERS)
WRIST_JOINT = 1
"""Joint of the hand's articulation that is the wrist; joint 0 is the forearm, which does not move."""

_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# Directions in which fingers and thumb bend, at rest: to the palm, and across the palm.
_TO_PALM, _ACROSS_PALM = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.8, -0.6])
_WRIST_USUAL_RAD = 0.6


@dataclass(frozen=True, slots=True)
class _Hinge:
    lowest_deg: float
    highest_deg: float
    rest_deg: float
    usual_deg: float

    def freedom(self, joint: str, axis: Float[np.ndarray, " 3"]) -> Freedom:
        x, y, z = axis.tolist()
        limits_rad = float(np.radians(self.lowest_deg)), float(np.radians(self.highest_deg))
        usual_rad, rest_rad = float(np.radians(self.usual_deg)), float(np.radians(self.rest_deg))
        return Freedom((joint,), (x, y, z), usual_rad, limits_rad, rest_rad)


_FINGER = (
    _Hinge(-20.0, 20.0, 0.0, 10.0),
    _Hinge(-20.0, 95.0, 15.0, 40.0),
    _Hinge(0.0, 115.0, 25.0, 40.0),
    _Hinge(0.0, 90.0, 12.0, 25.0),
)
_THUMB = (
    _Hinge(-45.0, 45.0, 0.0, 30.0),
    _Hinge(-45.0, 60.0, 0.0, 30.0),
    _Hinge(0.0, 70.0, 10.0, 30.0),
    _Hinge(0.0, 85.0, 12.0, 30.0),
)


@dataclass(frozen=True, slots=True, eq=False)
class Finger:
    """Finger of one side at rest."""

    joints: tuple[int, ...]  # Numbers of its joints in ``WHOLE_SKELETON`` from the palm, the end last
    directions: Float[np.ndarray, "4 3"]  # Rest directions of the bones to these joints
    # Axes of the spread of the base, and of the bends of its three joints. A positive spread moves the finger to the
    # thumb's side, a positive bend to the palm.
    spread_axis: Float[np.ndarray, " 3"]
    bend_axes: Float[np.ndarray, "3 3"]


@cache
def hand_fingers(side: Side) -> Mapping[str, Finger]:
    """Fingers of a hand by name."""
    return {name: _finger(side, name) for name in FINGERS}


def _finger(side: Side, name: str) -> Finger:
    joints = _chain(f"{side.capitalize()}Hand{name.capitalize()}1")
    directions = np.array([WHOLE_SKELETON[number].rest_direction for number in joints])
    toward = _ACROSS_PALM if name == "thumb" else _TO_PALM
    bend_axes = np.cross(directions[1:], toward)
    bend_axes /= np.linalg.norm(bend_axes, axis=-1, keepdims=True)
    # The spread turns in the plane in which the straight finger does not bend.
    spread_axis = np.cross(bend_axes[0], directions[1]) * (1.0 if side == "left" else -1.0)
    return Finger(joints, directions, spread_axis, bend_axes)


def _chain(first: str) -> tuple[int, ...]:
    names = [first]
    while following := [joint.name for joint in WHOLE_SKELETON if joint.parent == names[-1]]:
        names.append(following[0])
    return tuple(INDEX[name] for name in names)


def natural_rad() -> Float[np.ndarray, " hinges"]:
    """Angles of all hinges in the natural pose: slightly bent fingers."""
    hinges = [hinge for name in FINGERS for hinge in (_THUMB if name == "thumb" else _FINGER)]
    return np.radians([hinge.rest_deg for hinge in hinges])


def articulate_hand(side: Side, bone_length_m: Float[np.ndarray, " joints"]) -> Articulation:
    """Build the arrays of a hand.

    The joints are the forearm, the wrist at the same place, and four joints a finger, the first two of which share a
    place. The landmarks are the wrist and the 20 joints of ``finger_joints``, in this order. ``bone_length_m`` has the
    bones of ``WHOLE_SKELETON``.
    """
    index = {"forearm": 0, "wrist": WRIST_JOINT}
    parent, offset_m = [-1, 0], [np.zeros(3), np.zeros(3)]
    freedoms = [Freedom(("wrist",), axis, _WRIST_USUAL_RAD) for axis in _AXES]
    landmarks = [Carried(0, WRIST_JOINT, np.zeros(3), beside=False)]
    for name, finger in hand_fingers(side).items():
        bones_m = finger.directions * bone_length_m[list(finger.joints), None]
        hinges = _THUMB if name == "thumb" else _FINGER
        above = WRIST_JOINT
        places_m = (bones_m[0], np.zeros(3), bones_m[1], bones_m[2])
        for number, (hinge, axis, place_m) in enumerate(
            zip(hinges, (finger.spread_axis, *finger.bend_axes), places_m, strict=True)
        ):
            joint = f"{name} {number}"
            index[joint] = len(parent)
            parent.append(above)
            offset_m.append(place_m)
            freedoms.append(hinge.freedom(joint, axis))
            above = index[joint]
        first = index[f"{name} 0"]
        for joint_number in (first, first + 2, first + 3):
            landmarks.append(Carried(len(landmarks), joint_number, np.zeros(3), beside=False))
        landmarks.append(Carried(len(landmarks), first + 3, bones_m[3], beside=True))
    return build(index, tuple(freedoms), (), np.array(parent), np.array(offset_m), landmarks)


def local_rotations(
    side: Side,
    forearm: Float[np.ndarray, "frames 3 3"],
    wrist: Float[np.ndarray, "frames 3 3"],
    angle_rad: Float[np.ndarray, "frames hinges"],
) -> Float[np.ndarray, "frames joints 3 3"]:
    """Rotations of all joints of ``articulate_hand`` to their parents.

    ``forearm`` is its orientation in the world, ``wrist`` the rotation of the hand to it, ``angle_rad`` the angles of
    all hinges.
    """
    axes = np.concatenate([[finger.spread_axis, *finger.bend_axes] for finger in hand_fingers(side).values()])
    turned = Rotation.from_rotvec((angle_rad[..., None] * axes).reshape(-1, 3)).as_matrix()
    hinges = turned.reshape(*angle_rad.shape, 3, 3)
    return np.concatenate([forearm[:, None], wrist[:, None], hinges], axis=1)


def joint_rotations(
    side: Side, angle_rad: Float[np.ndarray, "frames hinges"]
) -> tuple[Int[np.ndarray, " joints"], list[Rotation]]:
    """Rotations of finger joints of ``WHOLE_SKELETON`` to their parents, ends left out, and the joints' numbers."""
    numbers: list[int] = []
    rotations: list[Rotation] = []
    for number, finger in enumerate(hand_fingers(side).values()):
        spread_rad, *bends_rad = angle_rad[:, HINGES * number : HINGES * (number + 1)].T
        bends = [
            Rotation.from_rotvec(bend_rad[:, None] * axis)
            for bend_rad, axis in zip(bends_rad, finger.bend_axes, strict=True)
        ]
        spread = Rotation.from_rotvec(spread_rad[:, None] * finger.spread_axis)
        numbers += finger.joints[:-1]
        rotations += [spread * bends[0], *bends[1:]]
    return np.array(numbers), rotations


def bend_angles_rad(
    side: Side, points_m: Float[np.ndarray, "frames landmarks 3"]
) -> Float[np.ndarray, "frames hinges"]:
    """Angles of all hinges from the positions of a hand's landmarks in the axes of the hand; NaN where unknown."""
    angle_rad = np.empty((len(points_m), NUM_HINGES))
    for number, finger in enumerate(hand_fingers(side).values()):
        chain_m = points_m[:, 1 + HINGES * number : 1 + HINGES * (number + 1)]
        bones_m = [after - before for before, after in pairwise(chain_m.swapaxes(0, 1))]
        straight = finger.directions[1]
        to_palm = np.cross(finger.bend_axes[0], straight)
        aside = np.cross(finger.spread_axis, straight)
        ahead_m = bones_m[0] @ straight
        here = angle_rad[:, HINGES * number : HINGES * (number + 1)]
        # Of a finger that is bent by a right angle, the spread is noise.
        aside_m = bones_m[0] @ aside
        is_ahead = ahead_m > 0.3 * np.linalg.norm(bones_m[0], axis=-1)
        here[:, 0] = np.where(is_ahead | np.isnan(ahead_m), np.arctan2(aside_m, ahead_m), 0.0)
        along_m = np.where(is_ahead, np.hypot(ahead_m, aside_m), ahead_m)
        here[:, 1] = np.arctan2(bones_m[0] @ to_palm, along_m)
        for hinge, (upper_m, lower_m) in enumerate(pairwise(bones_m), 2):
            sine = np.linalg.norm(np.cross(upper_m, lower_m), axis=-1)
            here[:, hinge] = np.arctan2(sine, (upper_m * lower_m).sum(-1))
    return angle_rad
