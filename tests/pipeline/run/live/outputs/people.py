"""People of live instants, and poses that receivers get, compared with the skeletons."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.core.joints import COCO_17
from pipeline.motion.skeleton.model import SKELETON, WHOLE_SKELETON, posed_joints
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

NUM_BONES = len(SKELETON)
JOINTS = COCO_17.names
TOLERANCE_M, TOLERANCE_DEG = 1e-4, 0.1


def live_skeleton(seed: int = 0, num_joints: int = NUM_BONES) -> LiveSkeleton:
    """Skeleton in a random pose within six metres of the origin."""
    rng = np.random.default_rng(seed)
    lengths_m = np.array([0.0, *rng.uniform(0.1, 0.4, num_joints - 1)])
    lengths_m[WHOLE_SKELETON.index(SKELETON[-1]) + 1 :] *= 0.1
    turns, root_m = Rotation.random(num_joints, rng=rng).as_quat(), rng.uniform(-6.0, 6.0, 3)
    motion = SkeletonMotion(1, "", 0, 25.0, lengths_m, root_m[None], turns[None], ())
    return LiveSkeleton(root_m, turns, lengths_m, posed_joints(motion)[0][0])


def world_matrices(skeleton: LiveSkeleton) -> np.ndarray:
    """Rotations of all joints in the world, as matrices."""
    turns, lengths_m = skeleton.parent_from_joint[None], skeleton.bone_length_m
    motion = SkeletonMotion(1, "", 0, 25.0, lengths_m, skeleton.root_m[None], turns, ())
    return np.array(posed_joints(motion)[1])[:, 0]


def live_instant(
    numbers: Sequence[int] = (1, 2, 3, 4), time_s: float = 12.25, num_joints: int = NUM_BONES, seed: int = 0
) -> LiveInstant:
    """People with skeletons; positions of joints are random."""
    xyz_m = np.random.default_rng(seed).uniform(-6.0, 6.0, (len(numbers), len(JOINTS), 3))
    people = [
        LivePerson(number, points_m, live_skeleton(1000 * seed + number, num_joints))
        for number, points_m in zip(numbers, xyz_m, strict=True)
    ]
    return LiveInstant(time_s, tuple(people), 0.05)


def skeleton_of(person: LivePerson) -> LiveSkeleton:
    """Skeleton of a person who has one."""
    assert person.skeleton is not None
    return person.skeleton


def angle_deg(first: np.ndarray, second: np.ndarray) -> float:
    """Largest angle between rotation matrices."""
    return float(np.degrees((Rotation.from_matrix(first) * Rotation.from_matrix(second).inv()).magnitude().max()))
