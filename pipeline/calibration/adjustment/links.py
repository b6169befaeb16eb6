"""Links between free points: further residuals of an adjustment, such as constant bone lengths and plausible speeds."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int


class LinkRows(NamedTuple):
    """Residuals of links in units of their standard deviations, with their derivatives."""

    residual: Float[np.ndarray, " rows"]  # Residuals
    # The two points of each row, and the derivatives by them
    points: Int[np.ndarray, "rows 2"]
    by_points: Float[np.ndarray, "rows 2 3"]
    # Number of the length in each row, and the derivative by it; the derivative is 0 in rows without a length
    length: Int[np.ndarray, " rows"]
    by_length: Float[np.ndarray, " rows"]


@runtime_checkable
class PointLink(Protocol):
    """Links of one kind."""

    def linearise(self, xyz_m: Float[np.ndarray, "points 3"], lengths_m: Float[np.ndarray, " lengths"]) -> LinkRows:
        """Residuals and derivatives at points and lengths."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DistanceLinks:
    """Distances of pairs of points that are equal to lengths, which the adjustment estimates too."""

    pairs: Int[np.ndarray, "links 2"]  # Numbers of two points
    length: Int[np.ndarray, " links"]  # Number of the length that each pair has
    sigma_m: Float[np.ndarray, " links"]  # Standard deviation of each distance from its length

    def linearise(self, xyz_m: Float[np.ndarray, "points 3"], lengths_m: Float[np.ndarray, " lengths"]) -> LinkRows:
        """Residuals ``(|a - b| - length) / sigma``."""
        apart_m = xyz_m[self.pairs[:, 0]] - xyz_m[self.pairs[:, 1]]
        distance_m = np.maximum(np.linalg.norm(apart_m, axis=-1), 1e-9)
        along = apart_m / (distance_m * self.sigma_m)[:, None]
        residual = (distance_m - lengths_m[self.length]) / self.sigma_m
        return LinkRows(residual, self.pairs, np.stack([along, -along], axis=1), self.length, -1.0 / self.sigma_m)


@dataclass(frozen=True, slots=True, eq=False)
class ShiftLinks:
    """Pairs of points that are close to each other: a joint at two instants."""

    pairs: Int[np.ndarray, "links 2"]  # Numbers of two points
    sigma_m: Float[np.ndarray, " links"]  # Standard deviation of the shift of each pair along an axis

    def linearise(self, xyz_m: Float[np.ndarray, "points 3"], lengths_m: Float[np.ndarray, " lengths"]) -> LinkRows:
        """Residuals ``(a - b) / sigma``, three a pair."""
        sigma_m = np.repeat(self.sigma_m, 3)
        residual = (xyz_m[self.pairs[:, 0]] - xyz_m[self.pairs[:, 1]]).ravel() / sigma_m
        along = np.tile(np.eye(3), (len(self.pairs), 1)) / sigma_m[:, None]
        none = np.zeros(len(residual))
        return LinkRows(
            residual, np.repeat(self.pairs, 3, axis=0), np.stack([along, -along], axis=1), none.astype(int), none
        )
