"""Deviations of bodies: steps from the pose of a body to the one at which each camera sees it, with their noise.

Cameras that are some milliseconds apart see a moving board at different poses. A pose that all of them share would bend
their lenses until it fits. Deviations are random effects with variances that the observations tell (Laird and Ware
1982, "Random-effects models for longitudinal data"; Pinheiro et al. 2001, "Efficient algorithms for robust estimation
in linear mixed-effects models using the multivariate t distribution"): each camera's own views then determine its lens,
and shared ones the poses of the cameras as exactly as they agree.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.arrays import read_only

# Standard deviations with which the search begins, and the least ones: radians and metres.
_FIRST, _LEAST = np.array([0.03, 0.02]), np.array([1e-6, 1e-6])
# Degrees of freedom of Student's t: boards are held still at some instants, and carried fast at others.
_FREEDOM = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Deviations:
    """Deviations of each camera's view of each body."""

    # Steps of ``structure.RigidBodies`` beyond those that times explain
    step: Float[np.ndarray, "cameras bodies 6"]
    scale: Float[np.ndarray, " 2"]  # Standard deviations of a rotation about an axis, and of a shift along one
    weight: Float[np.ndarray, " bodies"]  # Variances of a body are smaller by this factor
    speed: Float[np.ndarray, "bodies 6"]  # Steps a second by which each body moves; 0 where that is not known
    # Time of each view after its body's time, as clocks tell, and what each camera is late beyond that
    late_s: Float[np.ndarray, "cameras bodies"]
    delay_s: Float[np.ndarray, " cameras"]

    @property
    def total(self) -> Float[np.ndarray, "cameras bodies 6"]:
        """Whole steps: bodies move on until a late camera sees them."""
        return self.step + (self.late_s + self.delay_s[:, None])[:, :, None] * self.speed

    @property
    def sigma(self) -> Float[np.ndarray, "cameras bodies 6"]:
        """Standard deviations of the steps."""
        of_bodies = np.repeat(self.scale, 3) / np.sqrt(self.weight)[:, None]
        return np.broadcast_to(of_bodies, self.step.shape)


class Posterior(NamedTuple):
    """Uncertainty of the deviations that the observations leave, for given cameras."""

    covariance: Float[np.ndarray, "cameras bodies 6 6"]
    is_seen: Bool[np.ndarray, "cameras bodies"]


def first_deviations(late_s: Float[np.ndarray, "cameras bodies"], speed: Float[np.ndarray, "bodies 6"]) -> Deviations:
    """Deviations with which a search begins."""
    num_cameras, num_bodies = late_s.shape
    zeros = read_only(np.zeros((num_cameras, num_bodies, 6)))
    return Deviations(zeros, _FIRST, read_only(np.ones(num_bodies)), speed, late_s, read_only(np.zeros(num_cameras)))


def posterior(
    deviations: Deviations, by_view: Float[np.ndarray, "cameras bodies 6 6"], bodies: Float[np.ndarray, "bodies 6 6"]
) -> Posterior:
    """Compute the posterior of the deviations.

    ``by_view``: normal matrices of each camera's view of each body. ``bodies``: normal matrices of the bodies, with the
    deviations eliminated.
    """
    own = np.linalg.inv(by_view + (deviations.sigma**-2.0)[..., None] * np.eye(6))
    is_seen = by_view.any((2, 3))
    of_bodies = np.zeros_like(bodies)
    of_bodies[is_seen.any(0)] = np.linalg.inv(bodies[is_seen.any(0)])
    gain = own @ by_view
    return Posterior(own + gain @ of_bodies @ gain.swapaxes(2, 3), np.asarray(is_seen))


def num_effective(deviations: Deviations, found: Posterior) -> float:
    """Effective number of unknowns that the deviations are."""
    variance = np.diagonal(found.covariance, axis1=2, axis2=3)
    return float((1.0 - variance / deviations.sigma**2)[found.is_seen].sum())


def estimated(deviations: Deviations, found: Posterior) -> Deviations:
    """Deviations with variances that fit them better: a step of expectation maximisation.

    Bodies that one camera sees tell nothing of them.
    """
    is_shared = found.is_seen & (found.is_seen.sum(0) > 1)
    if not is_shared.any():
        return deviations
    squares = deviations.step**2 + np.diagonal(found.covariance, axis1=2, axis2=3)
    by_kind = np.where(is_shared[..., None], squares.reshape(*is_shared.shape, 2, 3).sum(-1), 0.0).sum(0)
    num_views = is_shared.sum(0)
    distance = (by_kind / deviations.scale**2).sum(-1)
    weight = np.where(num_views > 0, (_FREEDOM + 6 * num_views) / (_FREEDOM + distance), 1.0)
    weighted = np.where(num_views > 0, weight, 0.0)
    scale = np.sqrt(weighted @ by_kind / (3 * (weighted @ num_views)))
    return replace(deviations, scale=read_only(np.maximum(scale, _LEAST)), weight=read_only(weight))
