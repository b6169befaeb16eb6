"""Rotations in files: Rodrigues vectors, matrices, quaternions."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.parsing import ROTATION_VECTOR_RAD, UnreadableError, read_numbers

_MIN_NORM, _MAX_NORM = 1e-3, 1e3


def rodrigues_matrix(rodrigues: Any) -> np.ndarray | None:
    """Matrix of a Rodrigues vector (radians), ``None`` if it is missing; others raise ``UnreadableError``."""
    if rodrigues is None:
        return None
    vector = read_numbers(rodrigues)
    if vector.shape != (3,) or not ROTATION_VECTOR_RAD.holds(vector):
        raise UnreadableError
    return Rotation.from_rotvec(vector).as_matrix()


def rotation_matrix(value: Any) -> np.ndarray | None:
    """Matrix of a Rodrigues vector in a list, a row or a column, or the matrix itself; ``None`` if it is missing.

    Raises ``UnreadableError`` for other values. Whether a matrix is a rotation is left to the checks.
    """
    if value is None:
        return None
    array = read_numbers(value)
    if array.shape == (3, 3):
        return array
    if array.size != max(array.shape, default=0):
        raise UnreadableError
    return rodrigues_matrix(array.ravel().tolist())


def quaternion_matrix(xyzw: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion with the scalar last, of any plausible length; raises ``UnreadableError`` for others."""
    if xyzw.shape != (4,) or not _MIN_NORM < np.abs(xyzw).max() < _MAX_NORM:
        raise UnreadableError
    return Rotation.from_quat(xyzw).as_matrix()
