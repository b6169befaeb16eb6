"""Marks of detectors beside the centres of joints: where a network marks a joint, and where the joint is.

A network that learnt from people's annotations marks what the annotators clicked: the top of a shoulder, the front of
an ear. The offset of such a mark from the joint's centre is constant in the axes of the part of the body that carries
it: for shoulders the collar bone, whose axes are the chest's at rest; for hips the pelvis; for the face the
head. In these axes a person faces -Y, with the left side to +X (``skeleton.model``).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import JointOffsets, JointSet
from pipeline.motion.skeleton.landmarks import Landmarks
from pipeline.motion.skeleton.model import INDEX, TRUNK, joint_pose
from pipeline.motion.skeleton.rigid_parts import solve_head, solve_torso

_GIRDLES = ("hip", "shoulder")


def has_torso(xyz_m: Float[np.ndarray, "frames joints 3"], joints: JointSet) -> bool:
    """True if a hip or a shoulder has a position in any frame; without them, a skeleton's position is arbitrary."""
    girdles = [index for index, name in enumerate(joints.names) if name.endswith(_GIRDLES)]
    return bool(np.isfinite(xyz_m[:, girdles]).any())


def part_of_mark(name: str) -> str:
    """Joint of the skeleton whose axes carry the mark of a joint of the detector: of a hip, a shoulder, or the face."""
    side, _, kind = name.rpartition("_")
    return {"shoulder": f"{side.capitalize()}Shoulder", "hip": "Hips"}.get(kind, "Head")


def trunk_length_m(bone_length_m: Float[np.ndarray, " joints"]) -> float:
    """Length of a skeleton's trunk, from the centre between the hips to the centre between the shoulders."""
    return float(bone_length_m[[INDEX[name] for name in TRUNK]].sum())


def mark_offsets_m(joints: JointSet, offsets: JointOffsets, trunk_m: float) -> Mapping[str, Float[np.ndarray, " 3"]]:
    """Offsets of a person's marks from the centres of their joints by name, in metres and in the axes of the part.

    ``trunk_m`` is the length of the person's trunk.
    """
    centres = {}
    for name in joints.names:
        side, _, kind = name.rpartition("_")
        if kind in offsets:
            offset = offsets[kind]
            outwards = {"left": 1.0, "right": -1.0}.get(side, 0.0) * offset.outwards
            centres[name] = trunk_m * np.array([outwards, -offset.forward, offset.up])
    return centres


def centers_from_marks(
    landmarks: Landmarks, offsets: JointOffsets, marked_length_m: Float[np.ndarray, " joints"]
) -> np.ndarray:
    """Centres of joints from marks, each frame by itself.

    Marks are NaN where unknown; lengths are measured between marks. World positions are in metres, (frames,
    joints, 3); joints of a face that is not known as a whole stay at their marks.
    """
    # Between the marks, the trunk is longer than the skeleton's by the difference of their heights.
    higher = sum(sign * offsets[kind].up for kind, sign in (("shoulder", 1.0), ("hip", -1.0)) if kind in offsets)
    trunk_m = trunk_length_m(marked_length_m) / (1.0 + higher)
    torso = solve_torso(landmarks, marked_length_m)
    head = solve_head(landmarks, torso)
    centers_m = np.array(landmarks.xyz_m)
    for name, offset_m in mark_offsets_m(landmarks.joints, offsets, trunk_m).items():
        number, part = landmarks.joints.index(name), part_of_mark(name)
        if part == "Head":
            centers_m[:, number] -= np.where(head.valid[:, None], head.world_from_head.apply(offset_m), 0.0)
        else:
            world_from_part = torso.world_from_pelvis if part == "Hips" else torso.world_from_chest
            centers_m[:, number] -= world_from_part.apply(offset_m)
    return centers_m


def marks_from_centers(
    centers_m: Float[np.ndarray, "rows joints 3"],
    motion: SkeletonMotion,
    rows: slice,
    joints: JointSet,
    offsets: JointOffsets,
) -> Float[np.ndarray, "rows joints 3"]:
    """Marks that a detector would set in frames of a fitted motion, to be compared with its observations.

    ``centers_m`` are final positions in ``rows`` of the motion, NaN where unknown; they are returned if it was fitted
    without ``offsets``.
    """
    if not offsets:
        return centers_m
    shown = replace(motion, root_m=motion.root_m[rows], parent_from_joint=motion.parent_from_joint[rows])
    marks_m = np.array(centers_m)
    offsets_m = mark_offsets_m(joints, offsets, trunk_length_m(motion.bone_length_m))
    for part in dict.fromkeys(map(part_of_mark, offsets_m)):
        _, world_from_part = joint_pose(shown, part)
        for name, offset_m in offsets_m.items():
            if part_of_mark(name) == part:
                marks_m[:, joints.index(name)] += world_from_part.apply(offset_m)
    return marks_m
