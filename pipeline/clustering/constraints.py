"""What a hypothesis has to agree with: its parent's appearance and the lengths of bones (section 3.2.1, eq. 1-3)."""

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.clustering.bone_lengths import LimbLengths

SECOND_CHANCE = 2.0
"""What tau3 is multiplied with for a parent to whom eq. 3 leaves no hypothesis, and for joints that were located."""
_SHORTEST_M = 0.02


def membership(
    parent_body: Int[np.ndarray, "parents cameras"], body: Int[np.ndarray, "points cameras"]
) -> Float[np.ndarray, "parents points"]:
    """Connectivity score S (eq. 1) of 2D detections instead of part affinity fields.

    In a view that knows the detections behind both points, s is 1 if they are the same and 0 if not; S is the mean over
    those views, NaN where there is none.

    Parameters
    ----------
    parent_body, body
        The detection behind a point in each view, -1 where there is none.
    """
    known = (parent_body[:, None] >= 0) & (body[None] >= 0)
    same = known & (parent_body[:, None] == body[None])
    num_known = known.sum(-1)
    return np.where(num_known > 0, same.sum(-1) / np.maximum(num_known, 1), np.nan)


def is_connected(score: Float[np.ndarray, "parents points"], tau2: float) -> Bool[np.ndarray, "parents points"]:
    """Eq. 2; where no view can tell, nothing speaks against it."""
    return np.isnan(score) | (score >= tau2)


def length_error(
    parents_m: Float[np.ndarray, "parents 3"],
    points_m: Float[np.ndarray, "points 3"],
    joint: Int[np.ndarray, " points"],
    lengths: LimbLengths,
) -> Float[np.ndarray, "parents points"]:
    """How far a point's distance to a parent is from the length of somebody's bone, as a share of that (eq. 3).

    Parameters
    ----------
    joint
        Which joint each point is.

    Returns
    -------
        The smallest over all people; 0 where nobody's length is known; infinite where no human being's can be so.
    """
    distance_m = np.linalg.norm(parents_m[:, None] - points_m[None], axis=-1)
    error = np.full(distance_m.shape, np.inf)
    for known_m in lengths.known_m.T[:, joint]:
        error = np.fmin(error, np.abs(distance_m - known_m) / known_m)
    error = np.where(np.isnan(lengths.known_m).all(-1)[joint], 0.0, error)
    possible = (distance_m > _SHORTEST_M) & (distance_m < lengths.longest_m[joint])
    return np.where(possible, error, np.inf)
