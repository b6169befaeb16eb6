"""Problem of an adjustment: structures that cameras observe, links between free points, given cameras, priors."""

from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.calibration.adjustment.parameters import Free, Parameters
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera


@runtime_checkable
class Structure(Protocol):
    """Blocks with ``block_size`` parameters each."""

    @property
    def num_blocks(self) -> int:
        """Number of blocks."""
        ...

    @property
    def block_size(self) -> int:
        """Number of parameters of a block."""
        ...

    def in_world(
        self, block: Int[np.ndarray, " n"], model_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 size"]]:
        """World coordinates of points of the blocks, and their derivatives by the parameters of their block."""
        ...

    def moved(self, steps: Float[np.ndarray, "blocks size"]) -> "Structure":
        """Structure after a step of its parameters."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class FreePoints:
    """Free points; a point's place in the model has no meaning and is ignored."""

    xyz_m: Float[np.ndarray, "points 3"]

    @property
    def num_blocks(self) -> int:
        """Number of points."""
        return len(self.xyz_m)

    @property
    def block_size(self) -> int:
        """Three: the coordinates."""
        return 3

    def in_world(
        self, block: Int[np.ndarray, " n"], model_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """World coordinates, and identities."""
        return self.xyz_m[block], np.broadcast_to(np.eye(3), (len(model_m), 3, 3))

    def moved(self, steps: Float[np.ndarray, "points 3"]) -> "FreePoints":
        """Points after a shift of each, metres."""
        return FreePoints(read_only(self.xyz_m + steps))


@dataclass(frozen=True, slots=True, eq=False)
class RigidBodies:
    """Rigid bodies: ``x_in_world = rotation @ x_in_model + translation_m``.

    A step is a rotation in world axes about the body's origin (radians), and a shift (metres).
    """

    rotation: Float[np.ndarray, "bodies 3 3"]
    translation_m: Float[np.ndarray, "bodies 3"]

    @property
    def num_blocks(self) -> int:
        """Number of bodies."""
        return len(self.rotation)

    @property
    def block_size(self) -> int:
        """Six: a rotation and a shift."""
        return 6

    def in_world(
        self, block: Int[np.ndarray, " n"], model_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 6"]]:
        """World coordinates of points of the bodies, and their derivatives."""
        arm_m = np.einsum("nij,nj->ni", self.rotation[block], model_m)
        derivatives = np.zeros((len(block), 3, 6))
        x, y, z = arm_m.T
        # d(exp(w) arm)/dw = -[arm]_x
        derivatives[:, 0, 1], derivatives[:, 0, 2] = z, -y
        derivatives[:, 1, 0], derivatives[:, 1, 2] = -z, x
        derivatives[:, 2, 0], derivatives[:, 2, 1] = y, -x
        derivatives[:, :, 3:] = np.eye(3)
        return arm_m + self.translation_m[block], derivatives

    def moved(self, steps: Float[np.ndarray, "bodies 6"]) -> "RigidBodies":
        """Bodies after a step of each."""
        turn = Rotation.from_rotvec(steps[:, :3]).as_matrix()
        return RigidBodies(read_only(turn @ self.rotation), read_only(self.translation_m + steps[:, 3:]))


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
