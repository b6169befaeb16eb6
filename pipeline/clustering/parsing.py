"""Joints to people: limbs joined greedily in space (section 3.4)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.clustering.clusters import Joints
from pipeline.clustering.constraints import length_error, nearly_fits
from pipeline.clustering.distance import mean_distance_m
from pipeline.clustering.evidence import NOWHERE, Evidence
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.skeleton import Skeleton

# What a view more is worth beside connectivity, so that of two alike the better seen is taken.
_VIEW_WORTH = 0.01


class Poses(NamedTuple):
    """Everybody at one instant, joints in the skeleton's order.

    Parameters
    ----------
    xyz_m
        (people, joints, 3), NaN where a joint was not found.
    candidate
        The candidate behind a joint in each view, (people, joints, cameras), ``NOWHERE`` where there is none.
    """

    xyz_m: np.ndarray
    candidate: np.ndarray


def parse(
    found: Joints, evidence: Evidence, skeleton: Skeleton, lengths: LimbLengths, parameters: ClusteringParameters
) -> Poses:
    """Assemble people, each from a root joint on; a joint belongs to one person."""
    by_joint = [found.of(j) for j in range(len(skeleton.names))]
    shape = len(by_joint[0].candidate), len(by_joint)
    joint_of = np.full(shape, NOWHERE)
    joint_of[:, 0] = np.arange(len(joint_of))
    for j in range(1, len(by_joint)):
        parent = skeleton.parents[j]
        holders = np.flatnonzero(joint_of[:, parent] >= 0)
        if len(holders) and len(by_joint[j].candidate):
            held = by_joint[parent].where(joint_of[holders, parent])
            for holder, joint in _join(held, by_joint[j], evidence, lengths, parameters):
                joint_of[holders[holder], j] = joint
    xyz_m = np.full((*shape, 3), np.nan)
    candidate = np.full((*shape, found.candidate.shape[1]), NOWHERE)
    for j, joints in enumerate(by_joint):
        holders = np.flatnonzero(joint_of[:, j] >= 0)
        mine = joint_of[holders, j]
        xyz_m[holders, j] = joints.places.xyz_m[mine]
        candidate[holders, j] = joints.candidate[mine]
    enough = np.flatnonzero((joint_of[:, skeleton.core] >= 0).sum(-1) >= parameters.min_joints)
    distinct = _distinct(xyz_m[enough], (candidate[enough] >= 0).sum((1, 2)), parameters.duplicate_m)
    return Poses(xyz_m[enough[distinct]], candidate[enough[distinct]])


def _join(
    holders: Joints, joints: Joints, evidence: Evidence, lengths: LimbLengths, parameters: ClusteringParameters
) -> list[tuple[int, int]]:
    """Pairs of a person's parent joint and a joint, the best first, each once."""
    error = length_error(holders.places.xyz_m, joints.places.xyz_m, joints.places.joint, lengths)
    possible = error <= parameters.leniency * parameters.tau3
    score = evidence.connect(holders.places, joints.places, possible)
    least = evidence.least[joints.places.joint] * parameters.use_connectivity
    measured = lengths.is_measured[joints.places.joint]
    allowed = possible & nearly_fits(score, least, error, parameters.tau3, measured, parameters.leniency)
    value = np.nan_to_num(score, nan=0.0) + _VIEW_WORTH * (joints.candidate >= 0).sum(-1)
    pairs: list[tuple[int, int]] = []
    for flat in np.argsort(-np.where(allowed, value, -1.0), axis=None, kind="stable")[: int(allowed.sum())]:
        holder, joint = divmod(int(flat), value.shape[1])
        if all(holder != one and joint != other for one, other in pairs):
            pairs.append((holder, joint))
    return pairs


def _distinct(
    xyz_m: Float[np.ndarray, "people joints 3"], support: Int[np.ndarray, " people"], duplicate_m: float
) -> list[int]:
    """Of poses in one place the best supported, in their order."""
    kept: list[int] = []
    for one in np.argsort(-support, kind="stable").tolist():
        if not np.any(mean_distance_m(xyz_m[kept], xyz_m[one]) < duplicate_m):
            kept.append(one)
    return sorted(kept)
