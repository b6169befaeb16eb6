"""What a hypothesis has to agree with: its parent's appearance and the lengths of bones (section 3.2.1, eq. 1-3)."""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.clustering.bone_lengths import LimbLengths
from pipeline.clustering.instant.evidence import Places
from pipeline.clustering.skeleton import Skeleton

_SHORTEST_M = 0.02


def fits(
    score: Float[np.ndarray, "parents points"],
    least: Float[np.ndarray, " points"],
    error: Float[np.ndarray, "parents points"],
    tau3: float,
) -> Bool[np.ndarray, "parents points"]:
    """Eq. 2 and 3; where no view can tell what is connected, nothing speaks against it."""
    return (np.isnan(score) | (score >= least)) & (error <= tau3)


def nearly_fits(
    score: Float[np.ndarray, "parents points"],
    least: Float[np.ndarray, " points"],
    error: Float[np.ndarray, "parents points"],
    tau3: float,
    is_measured: Bool[np.ndarray, " points"],
    leniency: float,
) -> Bool[np.ndarray, "parents points"]:
    """Eq. 2 and 3 where one of them may be missed: a second chance.

    Two views alone are less exact than the joint will be, and fields of limbs that touch weaken each other.

    Parameters
    ----------
    is_measured
        Whether anybody's length is known for the limb: only then it can make up for connectivity.
    leniency
        How many times worse either may be where the other is as it should.
    """
    weakly = fits(score, least / leniency, error, tau3) & is_measured
    return fits(score, least, error, leniency * tau3) | weakly


def length_error(
    parents: Places, points: Places, skeleton: Skeleton, lengths: LimbLengths
) -> Float[np.ndarray, "parents points"]:
    """How far a point's distance to a parent is from the length of somebody's bone, as a share of that (eq. 3).

    Returns
    -------
        The smallest over all people; 0 where nobody's length is known; infinite where no human being's can be so, and
        where no limb leads from the one kind of joint to the other.
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


def _relative_error(
    distance_m: Float[np.ndarray, " n"], known_m: Float[np.ndarray, " people"]
) -> Float[np.ndarray, " n"]:
    """Smallest ``|distance - known| / known``: that of the next shorter or the next longer of the known lengths."""
    ascending_m = np.sort(known_m[~np.isnan(known_m)])
    longer = np.searchsorted(ascending_m, distance_m, side="right")
    error = np.full(len(distance_m), np.inf)
    for neighbour in (longer - 1, longer):
        is_known = (neighbour >= 0) & (neighbour < len(ascending_m))
        neighbour_m = ascending_m[np.where(is_known, neighbour, 0)]
        error = np.where(is_known, np.fmin(error, np.abs(distance_m - neighbour_m) / neighbour_m), error)
    return error
