"""Poses of a person in a range of frames: parts of motions, blends of two, and joints that they carry."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.people import Track3D
from pipeline.core.joints import FINGERS, JointSet
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.fitting.articulation import joint_of_landmark
from pipeline.motion.skeleton.fitting.fit import FittedProportions, SkeletonFit
from pipeline.motion.skeleton.hands.anatomy import hand_fingers
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics, joint_pose
from pipeline.motion.skeleton.rigid_parts import landmark_offsets_m


def known_proportions(track: Track3D, motion: SkeletonMotion, joints: JointSet) -> FittedProportions:
    """Proportions with which a person was fitted."""
    offsets_m = {}
    for name in landmark_offsets_m(track, joints, motion.bone_length_m):
        joint_m, world_from_joint = joint_pose(motion, str(joint_of_landmark(name)))
        inside_m = world_from_joint.inv().apply(track.xyz_m[:, joints.index(name)] - joint_m)
        offsets_m[name] = np.nanmedian(inside_m, axis=0)
    return FittedProportions(motion.bone_length_m, offsets_m)


def rows_of(motion: SkeletonMotion, rows: slice) -> SkeletonMotion:
    """Some rows of a motion, without contacts."""
    root_m, quat = motion.root_m[rows], motion.parent_from_joint[rows]
    return replace(
        motion, start_frame=motion.start_frame + rows.start, root_m=root_m, parent_from_joint=quat, contacts=()
    )


def body_of(motion: SkeletonMotion) -> SkeletonMotion:
    """Motion without hands."""
    number = len(SKELETON)
    return replace(
        motion, bone_length_m=motion.bone_length_m[:number], parent_from_joint=motion.parent_from_joint[:, :number]
    )


def blended(first: SkeletonMotion, second: SkeletonMotion, share: Float[np.ndarray, " frames"]) -> SkeletonMotion:
    """Motion that passes from one motion to another one: bones keep their length, and hinges their axis."""
    root_m = np.where(
        (share > 0)[:, None], first.root_m + share[:, None] * (second.root_m - first.root_m), first.root_m
    )
    quat = np.array(first.parent_from_joint)
    for row in np.flatnonzero(share):
        near = second.parent_from_joint[row]
        near = near * np.where((near * first.parent_from_joint[row]).sum(-1) < 0, -1.0, 1.0)[:, None]
        mixed = (1.0 - share[row]) * first.parent_from_joint[row] + share[row] * near
        mixed /= np.linalg.norm(mixed, axis=-1, keepdims=True)
        if row:
            mixed *= np.where((mixed * quat[row - 1]).sum(-1) < 0, -1.0, 1.0)[:, None]
        quat[row] = mixed
    return replace(first, root_m=root_m, parent_from_joint=quat)


def with_hands_in_world(motion: SkeletonMotion, before: SkeletonMotion) -> SkeletonMotion:
    """Motion whose hands keep their orientation in the world: fingers were seen, and forearms moved by keys."""
    if motion.parent_from_joint.shape[1] == len(SKELETON):
        return motion
    quat = np.array(motion.parent_from_joint)
    for side in ("Left", "Right"):
        _, world_from_hand = joint_pose(before, f"{side}Hand")
        _, world_from_forearm = joint_pose(motion, f"{side}ForeArm")
        quat[:, INDEX[f"{side}Hand"]] = (world_from_forearm.inv() * world_from_hand).as_quat()
    return replace(motion, parent_from_joint=quat)


def posed_m(fit: SkeletonFit) -> Float[np.ndarray, "frames joints 3"]:
    """Positions of the joints that a skeleton carries (metres), zero for others."""
    xyz_m = np.zeros(fit.track.xyz_m.shape)
    fit.place(slice(None), xyz_m)
    return xyz_m


def continued(quat_xyzw: Float[np.ndarray, "frames joints 4"]) -> Float[np.ndarray, "frames joints 4"]:
    """Quaternions with the signs that make them continuous; a whole turn that was corrected had changed them."""
    turns = (quat_xyzw[1:] * quat_xyzw[:-1]).sum(-1) < 0
    signs = np.cumprod(np.where(turns, -1.0, 1.0), axis=0)
    return np.concatenate([quat_xyzw[:1], quat_xyzw[1:] * signs[..., None]])


def all_posed_m(
    fit: SkeletonFit, motion: SkeletonMotion, joints: JointSet, body: JointSet
) -> Float[np.ndarray, "frames joints 3"]:
    """Positions of joints by a motion, with fingers; zero for joints that it does not carry."""
    xyz_m = np.zeros((len(motion.root_m), len(joints.names), 3))
    xyz_m[:, joints.indices(body.names)] = posed_m(fit)
    if motion.parent_from_joint.shape[1] > len(SKELETON):
        everywhere_m = forward_kinematics(motion)
        for side in SIDES:
            for finger, numbers in ((name, finger.joints) for name, finger in hand_fingers(side).items()):
                for kind, number in zip(FINGERS[finger], numbers, strict=True):
                    if (name := f"{side}_{finger}_{kind}") in joints.names:
                        xyz_m[:, joints.index(name)] = everywhere_m[:, number]
    return xyz_m
