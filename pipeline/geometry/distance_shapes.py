"""Places of points from their distances to each other, by classical scaling (Torgerson 1952) and least squares.

Least squares are by majorization (de Leeuw 1977), whose steps are products of matrices. Distances leave the axes open,
and which of two mirror images it is.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

# Error of a measured distance, as a share of the largest one.
_MAX_ERROR = 0.03
# Steps of least squares at most, and the largest way of a point in the last one, as a share of the largest distance.
_MAX_STEPS, _LAST_STEP = 500, 1e-7


class DistancesError(ValueError):
    """Distances contradict each other, or do not fix a shape; the message says which."""


def places_from_distances(
    names: Sequence[str], distances_m: Float[np.ndarray, "points points"]
) -> Float[np.ndarray, "points 3"]:
    """Places (metres) of points around their middle from all their distances; symmetric, NaN where one is not stated.

    Raises ``DistancesError`` if a distance is missing, or no points have the distances within 3 % of the largest.

    Examples
    --------
    >>> places_m = places_from_distances("abc", np.array([[0.0, 3.0, 4.0], [3.0, 0.0, 5.0], [4.0, 5.0, 0.0]]))
    >>> float(np.linalg.norm(places_m[0] - places_m[2]).round(6))
    4.0
    """
    pairs = list(combinations(range(len(names)), 2))
    if missing := [f"{names[i]} to {names[j]}" for i, j in pairs if np.isnan(distances_m[i, j])]:
        raise DistancesError(f"several shapes have these distances; state {', '.join(missing[:8])}, too")
    centring = np.eye(len(names)) - 1.0 / len(names)
    values, vectors = np.linalg.eigh(-0.5 * centring @ distances_m**2 @ centring)
    places_m = vectors[:, :-4:-1] * np.sqrt(np.maximum(values[:-4:-1], 0.0))
    for _ in range(_MAX_STEPS):
        before_m, found_m = places_m, _apart_m(places_m)
        share = np.divide(distances_m, found_m, out=np.zeros_like(found_m), where=found_m > 0)
        places_m = (share.sum(1, keepdims=True) * before_m - share @ before_m) / len(names)
        if np.abs(places_m - before_m).max() <= _LAST_STEP * distances_m.max():
            break
    found_m = _apart_m(places_m)
    miss_m = np.abs(found_m - distances_m)
    if miss_m.max() > _MAX_ERROR * distances_m.max():
        worst = sorted(pairs, key=lambda pair: -miss_m[pair].round(4))[:3]
        shown = [f"{names[i]} to {names[j]} is {distances_m[i, j]:g} (fits {found_m[i, j]:.3g})" for i, j in worst]
        raise DistancesError(f"the distances contradict each other, in metres: {', '.join(shown)}")
    return places_m


def _apart_m(places_m: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points points"]:
    return np.linalg.norm(places_m[:, None] - places_m, axis=-1)
