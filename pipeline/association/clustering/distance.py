"""Distance of two poses."""

import numpy as np
from jaxtyping import Float


def mean_distance_m(
    first_m: Float[np.ndarray, "*#batch joints 3"], second_m: Float[np.ndarray, "*#batch joints 3"]
) -> Float[np.ndarray, "*batch"]:
    """Mean distance in metres of the joints that both poses have; infinite if they share none.

    Positions are in the world, NaN where a joint is unknown.
    """
    apart_m = np.linalg.norm(first_m - second_m, axis=-1)
    shared = np.isfinite(apart_m)
    total_m = np.where(shared, apart_m, 0.0).sum(-1)
    return np.where(shared.any(-1), total_m / np.maximum(shared.sum(-1), 1), np.inf)
