"""Assembly of poses from 3D joints: limbs are joined greedily (section 3.4)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.clusters import Joints
from pipeline.association.clustering.instant.constraints import length_error, nearly_fits
from pipeline.association.clustering.instant.evidence import NOWHERE, LimbEvidence
from pipeline.association.clustering.instant.work_limits import MAX_DENSE
from pipeline.association.clustering.linking import mean_distance_m
from pipeline.association.clustering.skeleton import LimbLengths, Skeleton

# Value of an additional view relative to connectivity: of similar limbs, the one seen in more views is taken.
_VIEW_WORTH = 0.01


class Poses(NamedTuple):
    """Poses of all people at one instant, joints in the skeleton's order."""

    xyz_m: np.ndarray  # World positions, (people, joints, 3); NaN where a joint was not found
    # Row of the candidate behind a joint in each view, (people, joints, cameras); ``NOWHERE`` for no candidate
    candidate: np.ndarray


def parse(
    joints: Joints,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
    known: Int[np.ndarray, "people joints"] | None = None,
) -> Poses:
    """Assemble poses from the root joints on; a joint belongs to at most one pose.

    Poses with fewer than ``min_joints`` of the paper's joints are left out, unless they are known. Of poses closer than
    ``duplicate_m``, the pose with the most observations is kept. ``known`` are joints of people who were found before,
    ``NOWHERE`` where a joint is missing; only missing joints are added.
    """
    if known is None:
        known = np.empty((0, len(skeleton.names)), int)
    is_free = np.ones(len(joints.points.joint), bool)
    is_free[known[known >= 0]] = False
    is_small = len(joints.points.joint) ** 2 <= MAX_DENSE
    value = _limb_values(joints, joints, evidence, skeleton, lengths, parameters) if is_small else None
    by_joint = [np.flatnonzero(is_free & (joints.points.joint == j)) for j in range(len(skeleton.names))]
    shape = len(known) + len(by_joint[0]), len(by_joint)
    joint_of = np.full(shape, NOWHERE)
    joint_of[: len(known)] = known
    joint_of[len(known) :, 0] = by_joint[0]
    for j in range(1, len(by_joint)):
        holders = np.flatnonzero((joint_of[:, skeleton.parents[j]] >= 0) & (joint_of[:, j] < 0))
        held = joint_of[holders, skeleton.parents[j]]
        of_limb = (
            _limb_values(joints.where(held), joints.where(by_joint[j]), evidence, skeleton, lengths, parameters)
            if value is None
            else value[np.ix_(held, by_joint[j])]
        )
        for holder, joint in _join(of_limb):
            joint_of[holders[holder], j] = by_joint[j][joint]
    has = joint_of >= 0
    xyz_m = np.full((*shape, 3), np.nan)
    candidate = np.full((*shape, joints.candidate.shape[1]), NOWHERE)
    xyz_m[has], candidate[has] = joints.points.xyz_m[joint_of[has]], joints.candidate[joint_of[has]]
    is_known = np.arange(len(has)) < len(known)
    enough = np.flatnonzero(is_known | (has[:, skeleton.core].sum(-1) >= parameters.min_joints))
    distinct = _distinct(xyz_m[enough], (candidate[enough] >= 0).sum((1, 2)), parameters.duplicate_m)
    return Poses(xyz_m[enough[distinct]], candidate[enough[distinct]])


def _limb_values(
    parents: Joints,
    joints: Joints,
    evidence: LimbEvidence,
    skeleton: Skeleton,
    lengths: LimbLengths,
    parameters: ClusteringParameters,
) -> Float[np.ndarray, "parents joints"]:
    """Value of a limb between each parent and each joint: connectivity and views; minus infinity if not allowed."""
    error = length_error(parents.points, joints.points, skeleton, lengths)
    possible = error <= parameters.leniency * parameters.tau3
    score = evidence.connect(parents.points, joints.points, possible)
    least = evidence.least[joints.points.joint] * parameters.use_connectivity
    measured = lengths.is_measured[joints.points.joint]
    allowed = possible & nearly_fits(score, least, error, parameters.tau3, measured, parameters.leniency)
    value = np.nan_to_num(score, nan=0.0) + _VIEW_WORTH * (joints.candidate >= 0).sum(-1)
    return np.where(allowed, value, -np.inf)


def _join(value: Float[np.ndarray, "holders joints"]) -> list[tuple[int, int]]:
    """Join limbs greedily: pairs of a pose and a joint in order of their value, each pose and joint once."""
    pairs: list[tuple[int, int]] = []
    holders: set[int] = set()
    joints: set[int] = set()
    for flat in np.argsort(-value, axis=None, kind="stable")[: int((value > -np.inf).sum())].tolist():
        holder, joint = divmod(flat, value.shape[1])
        if holder not in holders and joint not in joints:
            holders.add(holder)
            joints.add(joint)
            pairs.append((holder, joint))
    return pairs


def _distinct(
    xyz_m: Float[np.ndarray, "people joints 3"], support: Int[np.ndarray, " people"], duplicate_m: float
) -> list[int]:
    """Positions of the poses that are not duplicates of a pose with more observations, ascending."""
    kept: list[int] = []
    for pose in np.argsort(-support, kind="stable").tolist():
        if not np.any(mean_distance_m(xyz_m[kept], xyz_m[pose]) < duplicate_m):
            kept.append(pose)
    return sorted(kept)
