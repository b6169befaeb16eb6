"""Bones turned as a file of 3D points states the orientations of segments, in place of the fit's rotations."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.data.arrays import read_only
from pipeline.core.data.people import Track3D
from pipeline.motion.body_segments import SEGMENTS
from pipeline.motion.skeleton.model import INDEX, find_skeleton, forward_kinematics, posed_joints
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw

_PLACED = tuple(INDEX[f"{side}{bone}"] for side in ("Left", "Right") for bone in ("UpLeg", "Leg", "Foot", "Arm"))


def turned_as_stated(motion: SkeletonMotion, track: Track3D) -> SkeletonMotion:
    """Motion whose bones have the orientations that ``track.world_from_segment`` states, and others the fit's turns.

    The body is moved so that hips, knees, ankles and shoulders stay where the fit has them on average. Feet are then
    held by the stated orientations, so no contact is pinned. A motion without stated orientations is returned as it is.
    """
    if track.world_from_segment is None:
        return motion
    skeleton = find_skeleton(len(motion.bone_length_m))
    positions_m, fitted = posed_joints(motion)
    local = Rotation.from_quat(motion.parent_from_joint.reshape(-1, 4)).as_matrix()
    local = local.reshape(len(motion.root_m), len(skeleton), 3, 3)
    stated = {
        INDEX[segment.joint]: track.world_from_segment[:, number] @ segment.rest_from_segment.T
        for number, segment in enumerate(SEGMENTS.values())
    }
    world = list(fitted)
    quat = np.array(motion.parent_from_joint)
    for index, joint in enumerate(skeleton):
        above = world[INDEX[joint.parent]] if joint.parent else np.eye(3)
        world[index] = above @ local[:, index]
        if index in stated:
            known = np.isfinite(stated[index]).all((-1, -2))
            world[index] = np.where(known[:, None, None], stated[index], world[index])
            turn = Rotation.from_matrix(np.swapaxes(np.broadcast_to(above, world[index].shape), -1, -2) @ world[index])
            quat[:, index] = continuous_quat_xyzw(turn)
    turned = replace(
        motion,
        parent_from_joint=read_only(quat),
        contacts=tuple(
            replace(contact, pinned=False, slide_after_m=contact.slide_before_m) for contact in motion.contacts
        ),
    )
    moved_m = (positions_m - forward_kinematics(turned))[:, _PLACED].mean(1)
    return replace(turned, root_m=read_only(motion.root_m + moved_m))
