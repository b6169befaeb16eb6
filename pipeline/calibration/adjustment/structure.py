"""Structures that cameras observe: free points, or rigid bodies with known points (a board in each frame).

A structure consists of blocks, points or bodies, whose parameters an adjustment eliminates.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.core.data.arrays import read_only


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
