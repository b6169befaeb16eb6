"""Fingers of live people: poses of the hands from located joints, for programs that get whole skeletons.

The angles are the angles of ``skeleton.hands.anatomy``. That module computes long takes finger by finger; here all
fingers of a person are computed at once, since an instant is short.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.joints import FINGER_JOINTS, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import HINGES, hand_fingers, natural_rad
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON
from pipeline.motion.skeleton.rotations import align
from pipeline.run.live.pose_steps import quaternions_from_matrices
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_SHARES = np.array([joint.stature_share for joint in WHOLE_SKELETON])
_NAMES = [side.capitalize() for side in SIDES]
# Joints of both sides: from the root to the forearm, the hand and the end of its middle, and all fingers.
_ARMS = [
    [INDEX[joint.format(side)] for side in _NAMES]
    for joint in ("Hips", "Spine", "Chest", "{}Shoulder", "{}Arm", "{}ForeArm")
]
_HANDS, _HAND_ENDS = ([INDEX[f"{side}{joint}"] for side in _NAMES] for joint in ("Hand", "HandEnd"))
_END = np.array([WHOLE_SKELETON[number].rest_direction for number in _HAND_ENDS])
_FINGERS = [list(hand_fingers(side).values()) for side in SIDES]
_JOINTS = np.array([[finger.joints for finger in hand] for hand in _FINGERS])
_DIRECTIONS = np.array([[finger.directions for finger in hand] for hand in _FINGERS])
# Axes of the hinges of each finger, spread first, and their matrices of the cross product.
_AXES = np.array([[[finger.spread_axis, *finger.bend_axes] for finger in hand] for hand in _FINGERS])
_TURNS = np.cross(np.eye(3), _AXES[..., None, :]).swapaxes(-1, -2) * -1.0
_STRAIGHT = _DIRECTIONS[:, :, 1]
_TO_PALM, _ASIDE = np.cross(_AXES[:, :, 1], _STRAIGHT), np.cross(_AXES[:, :, 0], _STRAIGHT)
_NATURAL_RAD = natural_rad().reshape(-1, HINGES)
# Fewest located joints of all fingers, and of the four knuckles, of a hand that is seen well; distance of the knuckles
# from the wrist in metres. A finger that is bent by more than this cosine says nothing about its spread.
_FEWEST_JOINTS, _FEWEST_KNUCKLES, _KNUCKLES_M, _LEAST_AHEAD = 8, 3, (0.03, 0.20), 0.3
_NO_TURN = np.eye(3)


class FingerPoses:
    """Skeletons of people with fingers, one instant after the other.

    Lengths of fingers are adult proportions at the size of the forearm. A hand that is not seen well keeps its pose; it
    begins with the natural one. ``joints``: names of the joints of people.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self.has_fingers = set(joints) >= FINGER_JOINTS
        """True if there are joints of fingers. If not, people stay as they are."""
        sides = SIDES if self.has_fingers else ()
        self._wrists = [joints.index(f"{side}_wrist") for side in sides]
        self._fingers = [[joints.index(name) for name in finger_joints(side)] for side in sides]
        # Rotations of the hands to the forearms, and angles of all hinges, of each person
        self._poses: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def with_fingers(self, instant: LiveInstant) -> LiveInstant:
        """Instant whose skeletons have the joints of ``WHOLE_SKELETON``."""
        known = {person.id for person in instant.people}
        self._poses = {number: pose for number, pose in self._poses.items() if number in known}
        if not self.has_fingers:
            return instant
        return replace(instant, people=tuple(map(self._with_fingers, instant.people)))

    def _with_fingers(self, person: LivePerson) -> LivePerson:
        if (body := person.skeleton) is None:
            return person
        num_body = len(SKELETON)
        quat, joint_m = np.zeros((len(WHOLE_SKELETON), 4)), np.empty((len(WHOLE_SKELETON), 3))
        quat[:, 3], quat[:num_body], joint_m[:num_body] = 1.0, body.parent_from_joint, body.joint_m
        forearm = INDEX["LeftHand"]
        length_m = body.bone_length_m[forearm] / _SHARES[forearm] * _SHARES
        length_m[:num_body] = body.bone_length_m
        bones_m = _DIRECTIONS * length_m[_JOINTS][..., None]
        world = np.broadcast_to(_NO_TURN, (len(SIDES), 3, 3))
        for turn in Rotation.from_quat(quat[_ARMS].reshape(-1, 4)).as_matrix().reshape(len(_ARMS), len(SIDES), 3, 3):
            world = world @ turn
        forearm_from_hand, angle_rad = self._pose(person, world, bones_m[:, 1:, 0])
        local = _turned(angle_rad)
        local = np.stack([local[:, :, 0] @ local[:, :, 1], local[:, :, 2], local[:, :, 3]], axis=2)
        hand = world @ forearm_from_hand
        quat[_HANDS] = quaternions_from_matrices(forearm_from_hand)
        quat[_JOINTS[:, :, :-1].ravel()] = quaternions_from_matrices(local.reshape(-1, 3, 3))
        wrist_m = joint_m[_HANDS]
        joint_m[_HAND_ENDS] = wrist_m + (hand @ (_END * length_m[_HAND_ENDS, None])[..., None])[..., 0]
        place_m, world = wrist_m[:, None], hand[:, None]
        for bone in range(HINGES):
            place_m = place_m + (world @ bones_m[:, :, bone, :, None])[..., 0]
            joint_m[_JOINTS[:, :, bone]] = place_m
            world = world @ local[:, :, min(bone, HINGES - 2)]
        return replace(person, skeleton=LiveSkeleton(body.root_m, quat, length_m, joint_m))

    def _pose(
        self, person: LivePerson, forearm: Float[np.ndarray, "2 3 3"], palm_m: Float[np.ndarray, "2 4 3"]
    ) -> tuple[Float[np.ndarray, "2 3 3"], Float[np.ndarray, "2 5 4"]]:
        """Rotations of both hands to the forearms, and angles of their hinges."""
        turned, angle_rad = self._poses.get(
            person.id, (np.stack([_NO_TURN] * len(SIDES)), np.stack([_NATURAL_RAD] * len(SIDES)))
        )
        from_wrist_m = person.xyz_m[self._fingers] - person.xyz_m[self._wrists][:, None]
        knuckles_m = from_wrist_m[:, HINGES::HINGES]
        is_seen = _seen_well(from_wrist_m, knuckles_m)
        if is_seen.any():
            hand = align(palm_m, knuckles_m).as_matrix()
            measured_rad = _angles_rad((from_wrist_m @ hand).reshape(len(SIDES), -1, HINGES, 3))
            turned = np.where(is_seen[:, None, None], forearm.swapaxes(-1, -2) @ hand, turned)
            is_known = is_seen[:, None, None] & np.isfinite(measured_rad)
            angle_rad = np.where(is_known, measured_rad, angle_rad)
        self._poses[person.id] = turned, angle_rad
        return turned, angle_rad


def _seen_well(
    from_wrist_m: Float[np.ndarray, "2 20 3"], knuckles_m: Float[np.ndarray, "2 4 3"]
) -> Bool[np.ndarray, " 2"]:
    """Hands of which enough joints are located, with knuckles at a hand's distance from the wrist."""
    num_joints = np.isfinite(from_wrist_m).all(-1).sum(-1)
    reach_m = np.linalg.norm(knuckles_m, axis=-1)
    is_known = np.isfinite(reach_m)
    num_knuckles = is_known.sum(-1)
    mean_m = np.where(is_known, reach_m, 0.0).sum(-1) / np.maximum(num_knuckles, 1)
    is_near = (mean_m >= _KNUCKLES_M[0]) & (mean_m <= _KNUCKLES_M[1])
    return np.asarray((num_joints >= _FEWEST_JOINTS) & (num_knuckles >= _FEWEST_KNUCKLES) & is_near)


def _angles_rad(points_m: Float[np.ndarray, "2 5 4 3"]) -> Float[np.ndarray, "2 5 4"]:
    """Angles of all hinges from joints in the axes of the hands; NaN where unknown."""
    bones_m = np.diff(points_m, axis=2)
    first_m = bones_m[:, :, 0]
    ahead_m, aside_m, down_m = ((first_m * axis).sum(-1) for axis in (_STRAIGHT, _ASIDE, _TO_PALM))
    is_ahead = ahead_m > _LEAST_AHEAD * np.linalg.norm(first_m, axis=-1)
    spread_rad = np.where(is_ahead | np.isnan(ahead_m), np.arctan2(aside_m, ahead_m), 0.0)
    bend_rad = np.arctan2(down_m, np.where(is_ahead, np.hypot(ahead_m, aside_m), ahead_m))
    upper_m, lower_m = bones_m[:, :, :-1], bones_m[:, :, 1:]
    bends_rad = np.arctan2(np.linalg.norm(np.cross(upper_m, lower_m), axis=-1), (upper_m * lower_m).sum(-1))
    return np.concatenate([spread_rad[..., None], bend_rad[..., None], bends_rad], axis=-1)


def _turned(angle_rad: Float[np.ndarray, "2 5 4"]) -> Float[np.ndarray, "2 5 4 3 3"]:
    """Rotation of each hinge about its axis (Rodrigues)."""
    sine, cosine = np.sin(angle_rad)[..., None, None], np.cos(angle_rad)[..., None, None]
    return np.asarray(_NO_TURN + sine * _TURNS + (1.0 - cosine) * (_TURNS @ _TURNS))
