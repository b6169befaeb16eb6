"""Rigid transforms, named after their frames: ``x_in_b = b_from_a.apply(x_in_a)``."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, slots=True, eq=False)
class Rigid3:
    """Rotation and translation (metres): ``x_in_b = b_from_a.apply(x_in_a)``.

    Parameters
    ----------
    rotation, translation_m
        Rotation matrix, and translation in metres.

    Examples
    --------
    >>> Rigid3(np.eye(3), np.array([0.0, 0.0, 1.0])).apply(np.zeros(3)).tolist()
    [0.0, 0.0, 1.0]
    """

    rotation: Float[np.ndarray, "3 3"]
    translation_m: Float[np.ndarray, " 3"]

    def apply(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Map points (metres) from frame a to frame b; NaN stays NaN."""
        # One large product: NumPy computes a stack of small products one by one.
        return (points_m.reshape(-1, 3) @ self.rotation.T + self.translation_m).reshape(points_m.shape)

    @property
    def matrix(self) -> Float[np.ndarray, "3 4"]:
        """Matrix ``[R | t]``, 3 x 4."""
        return np.column_stack([self.rotation, self.translation_m])

    def inverse(self) -> "Rigid3":
        """Inverse transform ``a_from_b``."""
        return Rigid3(self.rotation.T.copy(), -self.rotation.T @ self.translation_m)

    def __matmul__(self, other: "Rigid3") -> "Rigid3":
        """Compose transforms: ``c_from_a = c_from_b @ b_from_a``."""
        return Rigid3(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)
