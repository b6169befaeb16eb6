"""PeopleAgreement of two cameras about people, by epipolar distances relative to the size of the people.

The measure has no unit, and needs neither the scale of the world nor an association of people.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.geometry.epipolar import distance_to_line_px
from pipeline.run.preflight.sightings import Points

FAR = 0.1
"""Distance, as a share of a person's extent in the picture, from which on a pair of bodies counts as not the same.

Detectors are off by 1 to 2 % of it. The next person is a body's width, a quarter of it, away.
"""
SURE = 0.015
"""Distance within which most pairs of bodies of one person are, and of different people as many as chance has it."""
# Distance within which a pair of bodies counts as exactly the same.
_EXACT = 0.03
# Fewer common joints are no evidence.
MIN_JOINTS = 5


@dataclass(frozen=True, slots=True)
class PeopleAgreement:
    """PeopleAgreement of two cameras about people."""

    disagreement: float = np.nan  # Mean distance of pairs of bodies: 0 if they agree, 1 if they do not; NaN without any
    exact_share: float = np.nan  # Share of these pairs that are exactly the same; NaN without any
    near_share: float = np.nan  # Share of these pairs that may be the same; NaN without any
    sure_share: float = np.nan  # Share of these pairs that are as near as one person's are; NaN without any
    num_pairs: int = 0  # Number of pairs of bodies at all instants together
    instants: frozenset[int] = frozenset()  # Places of the instants with a pair


def compare(
    fundamental: Float[np.ndarray, "3 3"], left: Sequence[Points | None], right: Sequence[Points | None]
) -> PeopleAgreement:
    """Compare the people whom two cameras see at the same instants by their epipolar distances.

    At each instant the people are paired so that the sum of their distances is least. The distance of a pair is the
    median over its joints, as a share of the people's extents in the pictures; above 0.1 it counts as 0.1, and the mean
    is divided by 0.1. A pair is exactly the same below 0.03. The people are undistorted, and
    ``x_left^T F x_right = 0``.
    """
    distances, instants = [np.empty(0)], []
    for instant, (first, second) in enumerate(zip(left, right, strict=True)):
        if first is not None and second is not None and len(first) and len(second):
            distance = body_distances(fundamental, first, second)
            # Beyond ``FAR`` all distances are alike: a person seen by one camera takes no body from another pair.
            distances.append(distance[linear_sum_assignment(np.minimum(distance, FAR))])
            instants.append(instant)
    if not instants:
        return PeopleAgreement()
    known = np.concatenate(distances)
    mean = float(np.mean(np.minimum(known, FAR))) / FAR
    exact, near, sure = (float(np.mean(known < limit)) for limit in (_EXACT, FAR, SURE))
    return PeopleAgreement(mean, exact, near, sure, len(known), frozenset(instants))


def body_distances(
    fundamental: Float[np.ndarray, "3 3"], left: Points, right: Points
) -> Float[np.ndarray, "left right"]:
    """Distances of all pairs of people; 1 for people with too few common joints."""
    of_left = np.concatenate([left, np.ones_like(left[..., :1])], axis=-1)
    of_right = np.concatenate([right, np.ones_like(right[..., :1])], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        of_pairs = np.broadcast_arrays(left[:, None], right[None])
        lines = np.broadcast_arrays((of_right @ fundamental.T)[None], (of_left @ fundamental)[:, None])
        in_left = distance_to_line_px(of_pairs[0], lines[0]) / extents_px(left)[:, None, None]
        in_right = distance_to_line_px(of_pairs[1], lines[1]) / extents_px(right)[None, :, None]
    shares = (in_left + in_right) / 2
    is_known = np.isfinite(shares)
    # The median of the known joints: unknown ones are sorted to the end.
    ordered = np.sort(np.where(is_known, shares, np.inf), axis=-1)
    count = is_known.sum(-1)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count >= MIN_JOINTS, np.minimum(middle, 1.0), 1.0)


def extents_px(people: Points) -> Float[np.ndarray, " people"]:
    """Diagonal of the box around each person's joints, at least a pixel."""
    low = np.where(np.isfinite(people), people, np.inf).min(1)
    high = np.where(np.isfinite(people), people, -np.inf).max(1)
    return np.maximum(np.hypot(*(high - low).T), 1.0)
