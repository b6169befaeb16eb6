"""Problem of an adjustment: given cameras, free parameters, priors, observations, links and the robust loss."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from jaxtyping import Float, Int

from pipeline.calibration.adjustment.links import PointLink
from pipeline.calibration.adjustment.parameters import Free, Parameters
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera


class Loss(Enum):
    """Loss of the distance of an observation from its projection, with 95 % efficiency for normal errors.

    Holland and Welsch 1977, "Robust regression using iteratively reweighted least-squares".
    """

    LINEAR = "linear"
    HUBER = "huber"
    CAUCHY = "cauchy"

    def weights(self, distance: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Weights of the squares, by the distances in standard deviations."""
        if self is Loss.HUBER:
            return np.minimum(1.0, _HUBER / np.maximum(distance, _HUBER))
        return 1.0 / (1.0 + (distance / _CAUCHY) ** 2) if self is Loss.CAUCHY else np.ones_like(distance)

    def cost(self, distance: Float[np.ndarray, " n"]) -> float:
        """Sum of the losses, equal to the sum of squares for small distances."""
        if self is Loss.HUBER:
            beyond = np.maximum(distance - _HUBER, 0.0)
            return float((np.minimum(distance, _HUBER) ** 2 + 2 * _HUBER * beyond).sum())
        squares = distance**2
        return float((_CAUCHY**2 * np.log1p(squares / _CAUCHY**2) if self is Loss.CAUCHY else squares).sum())


_HUBER, _CAUCHY = 1.345, 2.385


@dataclass(frozen=True, slots=True, eq=False)
class PointObservations:
    """Observations of points of the structure's blocks, in any order."""

    # Numbers of the camera and of the block
    camera: Int[np.ndarray, " n"]
    block: Int[np.ndarray, " n"]
    model_m: Float[np.ndarray, "n 3"]  # Place of the point in its body; without meaning for free points
    points_px: Float[np.ndarray, "n 2"]  # Distorted pixels


def observations_of_points(points_px: Float[np.ndarray, "points cameras 2"]) -> PointObservations:
    """List the observations of free points; NaN where a camera sees nothing."""
    block, camera = np.nonzero(np.isfinite(points_px).all(-1))
    return PointObservations(camera, block, np.zeros((len(block), 3)), points_px[block, camera])


def _no_lengths() -> Float[np.ndarray, " 0"]:
    return read_only(np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class AdjustmentProblem:
    """Data of an adjustment, and the parameters that it may change.

    The gauge is the caller's: leave the extrinsics of one camera fixed, and for free points also one coordinate of a
    second camera's position, or give priors; otherwise standard deviations of positions and rotations are infinite.
    """

    cameras: tuple[Camera, ...]  # Given cameras: means of the priors
    free: Free  # Parameters that may change
    # Standard deviations of the parameters before anything is observed; infinite where nothing is known
    prior_sigma: Parameters
    observations: PointObservations  # Observations
    loss: Loss = Loss.CAUCHY  # Robust loss of observations
    links: tuple[PointLink, ...] = ()  # Links between free points
    # Lengths of the links, with which the search begins, and their standard deviations as priors
    lengths_m: Float[np.ndarray, " lengths"] = field(default_factory=_no_lengths)
    length_sigma_m: Float[np.ndarray, " lengths"] = field(default_factory=_no_lengths)
