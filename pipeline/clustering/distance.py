"""How far apart two poses are."""

import numpy as np
from jaxtyping import Float


def mean_distance_m(
    one_m: Float[np.ndarray, "*#batch joints 3"], other_m: Float[np.ndarray, "*#batch joints 3"]
) -> Float[np.ndarray, "*batch"]:
    """Mean distance of the joints that both poses have; infinite where there is none."""
    apart_m = np.linalg.norm(one_m - other_m, axis=-1)
    shared = np.isfinite(apart_m)
    total_m = np.where(shared, apart_m, 0.0).sum(-1)
    return np.where(shared.any(-1), total_m / np.maximum(shared.sum(-1), 1), np.inf)
