"""Fingers of live people: poses of the hands from located joints, for programs that get whole skeletons."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from operator import mul

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side
from pipeline.core.joints import FINGER_JOINTS, finger_joints
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.hands.anatomy import bend_angles_rad, hand_fingers, joint_rotations, natural_rad
from pipeline.motion.skeleton.hands.hand_fit import KNUCKLES, seen_well
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, rest_offsets_m
from pipeline.motion.skeleton.rotations import align
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_SHARES = np.array([joint.stature_share for joint in WHOLE_SKELETON])
_FOREARM = INDEX["LeftHand"]
_ARM = ("Hips", "Spine", "Chest", "{}Shoulder", "{}Arm", "{}ForeArm")
# Joints that the pose of a hand moves.
_MOVED = [n for n, joint in enumerate(WHOLE_SKELETON) if n >= len(SKELETON) or joint.kind == "HandEnd"]


class FingerPoses:
    """Skeletons of people with fingers, one instant after the other.

    Lengths of fingers are adult proportions at the size of the forearm. A hand that is not seen well keeps its pose; it
    begins with the natural one. ``joints``: names of the joints of people.
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self.has_fingers = set(joints) >= FINGER_JOINTS
        """True if there are joints of fingers. If not, people stay as they are."""
        self._columns = {
            side: [joints.index(name) for name in (f"{side}_wrist", *finger_joints(side))]
            for side in SIDES
            if self.has_fingers
        }
        # Angles of all hinges, and rotation of the hand to the forearm, by person and side
        self._poses: dict[tuple[int, str], tuple[np.ndarray, np.ndarray]] = {}

    def with_fingers(self, instant: LiveInstant) -> LiveInstant:
        """Instant whose skeletons have the joints of ``WHOLE_SKELETON``."""
        people = [person for person in instant.people if person.skeleton is not None]
        known = {person.id for person in instant.people}
        self._poses = {key: pose for key, pose in self._poses.items() if key[0] in known}
        if not self.has_fingers or not people:
            return instant
        whole = dict(zip([person.id for person in people], self._skeletons(people), strict=True))
        return replace(
            instant, people=tuple(replace(person, skeleton=whole.get(person.id)) for person in instant.people)
        )

    def _skeletons(self, people: Sequence[LivePerson]) -> list[LiveSkeleton]:
        bodies = [person.skeleton for person in people if person.skeleton is not None]
        quat = np.tile([0.0, 0.0, 0.0, 1.0], (len(people), len(WHOLE_SKELETON), 1))
        length_m = np.array([body.bone_length_m[_FOREARM] / _SHARES[_FOREARM] * _SHARES for body in bodies])
        joint_m = np.empty((len(people), len(WHOLE_SKELETON), 3))
        for row, body in enumerate(bodies):
            quat[row, : len(SKELETON)], length_m[row, : len(SKELETON)] = body.parent_from_joint, body.bone_length_m
            joint_m[row, : len(SKELETON)] = body.joint_m
        world: dict[str, Rotation] = {}
        for side in SIDES:
            hand = f"{side.capitalize()}Hand"
            arm = [Rotation.from_quat(quat[:, INDEX[joint.format(side.capitalize())]]) for joint in _ARM]
            forearm = reduce(mul, arm)
            angle_rad, quat[:, INDEX[hand]] = self._hands(side, people, forearm, length_m)
            numbers, rotations = joint_rotations(side, angle_rad)
            for number, rotation in zip(numbers.tolist(), rotations, strict=True):
                quat[:, number] = rotation.as_quat()
            world[hand] = forearm * Rotation.from_quat(quat[:, INDEX[hand]])
        offset_m = np.array([rest_offsets_m(lengths_m) for lengths_m in length_m])
        for number in _MOVED:
            joint = WHOLE_SKELETON[number]
            above = world[joint.parent or ""]
            joint_m[:, number] = joint_m[:, INDEX[joint.parent or ""]] + above.apply(offset_m[:, number])
            world[joint.name] = above * Rotation.from_quat(quat[:, number])
        return [LiveSkeleton(body.root_m, *rows) for body, *rows in zip(bodies, quat, length_m, joint_m, strict=True)]

    def _hands(
        self, side: Side, people: Sequence[LivePerson], forearm: Rotation, length_m: Float[np.ndarray, "people whole"]
    ) -> tuple[Float[np.ndarray, "people hinges"], Float[np.ndarray, "people 4"]]:
        """Angles of the hinges of the hands of a side, and their rotations to the forearm."""
        points_m = np.array([person.xyz_m[self._columns[side]] for person in people])
        is_seen = seen_well(points_m[:, 0], points_m[:, 1:], np.isfinite(points_m[:, 1:]).all(-1), 1.0)
        fingers = [finger for name, finger in hand_fingers(side).items() if name != "thumb"]
        palm_m = np.stack([length_m[:, [finger.joints[0]]] * finger.directions[0] for finger in fingers], axis=1)
        from_wrist_m = points_m - points_m[:, :1]
        hand = align(palm_m, from_wrist_m[:, KNUCKLES])
        turned = (forearm.inv() * hand).as_quat()
        angle_rad = bend_angles_rad(side, np.einsum("pba,plb->pla", hand.as_matrix(), from_wrist_m))
        for row, person in enumerate(people):
            before = self._poses.get((person.id, side), (natural_rad(), np.array([0.0, 0.0, 0.0, 1.0])))
            if is_seen[row]:
                angle_rad[row] = np.where(np.isfinite(angle_rad[row]), angle_rad[row], before[0])
            else:
                angle_rad[row], turned[row] = before
            self._poses[person.id, side] = angle_rad[row], turned[row]
        return angle_rad, turned
