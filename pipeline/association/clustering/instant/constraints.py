"""Constraints on hypotheses: connectivity with a parent joint and bone lengths (section 3.2.1, eq. 1-3)."""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.clustering.instant.evidence import JointPoints
from pipeline.association.clustering.skeleton import LimbLengths, Skeleton

_SHORTEST_M = 0.02


def fits(
    score: Float[np.ndarray, "parents points"],
    least: Float[np.ndarray, " points"],
    error: Float[np.ndarray, "parents points"],
    tau3: float,
) -> Bool[np.ndarray, "parents points"]:
    """True if pairs satisfy eq. 2 and 3; a pair without evidence (score NaN) satisfies eq. 2.

    ``score`` is the connectivity, ``least`` the least one of each point; ``error`` is the relative error of the length,
    ``tau3`` the largest one that is allowed.
    """
    return (np.isnan(score) | (score >= least)) & (error <= tau3)


def nearly_fits(
    score: Float[np.ndarray, "parents points"],
    least: Float[np.ndarray, " points"],
    error: Float[np.ndarray, "parents points"],
    tau3: float,
    is_measured: Bool[np.ndarray, " points"],
    leniency: float,
) -> Bool[np.ndarray, "parents points"]:
    """True if pairs satisfy either of eq. 2 and 3, and the other one up to a factor.

    Hypotheses from two views are less accurate than the final joint, and fields of touching limbs weaken each other.
    See ``fits``. ``is_measured``: the limb's length is known for any person; only then may connectivity
    be weaker. ``leniency`` is the factor by which the other threshold may be missed.
    """
    weakly = fits(score, least / leniency, error, tau3) & is_measured
    return fits(score, least, error, leniency * tau3) | weakly


def length_error(
    parents: JointPoints, points: JointPoints, skeleton: Skeleton, lengths: LimbLengths
) -> Float[np.ndarray, "parents points"]:
    """Relative error of a point's distance to a parent against the known bone lengths (eq. 3).

    The smallest error over all people counts; 0 if no length is known; infinite for a distance that no person's limb
    has, and for joints without a limb between them.
    """
    error = np.full((len(parents.joint), len(points.joint)), np.inf)
    parent, point = np.nonzero(parents.joint[:, None] == np.array(skeleton.parents)[points.joint])
    distance_m = np.linalg.norm(parents.xyz_m[parent] - points.xyz_m[point], axis=-1)
    joint = points.joint[point]
    of_limb = np.zeros(len(joint))
    for kind in np.flatnonzero(lengths.is_measured):
        of_kind = np.flatnonzero(joint == kind)
        of_limb[of_kind] = _relative_error(distance_m[of_kind], lengths.known_m[kind])
    possible = (distance_m > _SHORTEST_M) & (distance_m < lengths.longest_m[joint])
    error[parent, point] = np.where(possible, of_limb, np.inf)
    return error


def pose_length_error(
    poses_m: Float[np.ndarray, "poses joints 3"], skeleton: Skeleton, lengths: LimbLengths
) -> Float[np.ndarray, "poses joints"]:
    """Relative error of the limb from each joint to its parent against the known bone lengths (eq. 3).

    The smallest error over all people counts; 0 if no length is known; infinite for a distance that no person's limb
    has; NaN where either end is missing.
    """
    distance_m = np.linalg.norm(poses_m - poses_m[:, list(skeleton.parents)], axis=-1)
    distance_m[:, 0] = np.nan  # the root has no limb
    error = np.zeros(distance_m.shape)
    for kind in np.flatnonzero(lengths.is_measured):
        error[:, kind] = _relative_error(distance_m[:, kind], lengths.known_m[kind])
    error[(distance_m <= _SHORTEST_M) | (distance_m >= lengths.longest_m)] = np.inf
    return np.where(np.isnan(distance_m), np.nan, error)


def _relative_error(
    distance_m: Float[np.ndarray, " n"], known_m: Float[np.ndarray, " people"]
) -> Float[np.ndarray, " n"]:
    """Smallest ``|distance - known| / known`` over the known lengths: the next shorter or the next longer length."""
    ascending_m = np.sort(known_m[~np.isnan(known_m)])
    longer = np.searchsorted(ascending_m, distance_m, side="right")
    error = np.full(len(distance_m), np.inf)
    for neighbour in (longer - 1, longer):
        is_known = (neighbour >= 0) & (neighbour < len(ascending_m))
        neighbour_m = ascending_m[np.where(is_known, neighbour, 0)]
        error = np.where(is_known, np.fmin(error, np.abs(distance_m - neighbour_m) / neighbour_m), error)
    return error
