"""Places of points from their distances to each other, by classical scaling (Torgerson 1952) and least squares.

Distances leave the axes open, and which of two mirror images it is.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

# Error of a measured distance, as a share of the largest one.
_MAX_ERROR = 0.03


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
    start_m = vectors[:, :-4:-1] * np.sqrt(np.maximum(values[:-4:-1], 0.0))
    first, second = np.array(pairs).T

    def missed_m(flat_m: Float[np.ndarray, " coordinates"]) -> Float[np.ndarray, " pairs"]:
        apart_m = flat_m.reshape(-1, 3)[first] - flat_m.reshape(-1, 3)[second]
        return np.linalg.norm(apart_m, axis=1) - distances_m[first, second]

    places_m: np.ndarray = least_squares(missed_m, start_m.ravel(), max_nfev=50).x.reshape(-1, 3)
    found_m = np.linalg.norm(places_m[:, None] - places_m, axis=-1)
    miss_m = np.abs(found_m - distances_m)
    if miss_m.max() > _MAX_ERROR * distances_m.max():
        worst = sorted(pairs, key=lambda pair: -miss_m[pair])[:3]
        shown = [f"{names[i]} to {names[j]} is {distances_m[i, j]:g} (fits {found_m[i, j]:.3g})" for i, j in worst]
        raise DistancesError(f"the distances contradict each other, in metres: {', '.join(shown)}")
    return places_m
