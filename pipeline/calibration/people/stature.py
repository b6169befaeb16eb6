"""Statures of people from the lengths of their segments."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.people.following import JOINTS

# Shin, thigh and trunk as shares of stature (Drillis and Contini 1966).
_SHARE = 0.246 + 0.245 + 0.288
_MIN_BODIES = 10


def _pair(kind: str) -> list[int]:
    return [JOINTS.index(f"{side}_{kind}") for side in ("left", "right")]


def statures(
    xyz: Float[np.ndarray, "n joints 3"], group: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " people"], Float[np.ndarray, " people"]]:
    """Estimate statures, in the unit of the points.

    Returns the stature of each group of which shin, thigh and trunk are known often enough, and its number of bodies.
    """
    ankle, knee, hip, shoulder = (xyz[:, _pair(kind)] for kind in ("ankle", "knee", "hip", "shoulder"))
    lengths = (
        np.linalg.norm(ankle - knee, axis=-1),
        np.linalg.norm(knee - hip, axis=-1),
        np.linalg.norm(shoulder.mean(1) - hip.mean(1), axis=-1)[:, None],
    )
    estimates, weights = [], []
    for number in np.unique(group):
        own = [length[group == number] for length in lengths]
        known = [lengths_of_bone[np.isfinite(lengths_of_bone)] for lengths_of_bone in own]
        if min(map(len, known)) >= _MIN_BODIES:
            estimates.append(sum(float(np.median(lengths_of_bone)) for lengths_of_bone in known) / _SHARE)
            weights.append(float(min(map(len, known))))
    return np.array(estimates), np.array(weights)


def scale_from(
    estimates: Float[np.ndarray, " people"], weights: Float[np.ndarray, " people"], stature_m: Sequence[float]
) -> float:
    """Metres a unit, with which the estimated statures are closest to known ones (sum of absolute logarithms).

    Nobody knows who is who, so each estimate is compared with the closest stature.
    """
    tried = np.log(np.array(stature_m)[:, None] / estimates[None]).ravel()
    distance = np.abs(np.log(estimates)[None, :, None] + tried[:, None, None] - np.log(np.array(stature_m)))
    return float(np.exp(tried[np.argmin((distance.min(-1) * weights).sum(-1))]))
