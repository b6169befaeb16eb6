"""Rotations in files: Rodrigues vectors, matrices, quaternions."""

from typing import Any

import numpy as np

from pipeline.calibration.reading import Reading
from pipeline.core.parsing import ROTATION_VECTOR_RAD, UnreadableError, read_numbers
from pipeline.core.problems.sessions import INVALID_ROTATION

_MIN_NORM, _MAX_NORM = 1e-3, 1e3


def read_rotation(value: Any, camera: str, reading: Reading) -> np.ndarray | None:
    """Matrix of a Rodrigues vector (radians) in a list, a row or a column, or the matrix itself; ``None`` if missing.

    Another value is a problem of the camera. Whether a matrix is a rotation is left to the checks.
    """
    if value is None:
        return None
    try:
        array = read_numbers(value)
    except UnreadableError:
        array = np.empty(0)
    if array.shape == (3, 3):
        return array
    if array.size == max(array.shape, default=0) == 3 and ROTATION_VECTOR_RAD.holds(array):
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

        return Rotation.from_rotvec(array.ravel()).as_matrix()
    message = f"The rotation is neither a matrix of 3 x 3 numbers nor a vector of 3 numbers from {ROTATION_VECTOR_RAD}."
    reading.complain(INVALID_ROTATION, message, camera, "rotation")
    return np.eye(3)  # so that the problem is reported only once


def quaternion_matrix(xyzw: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion with the scalar last, of any plausible length; raises ``UnreadableError`` for others."""
    if xyzw.shape != (4,) or not _MIN_NORM < np.abs(xyzw).max() < _MAX_NORM:
        raise UnreadableError
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

    return Rotation.from_quat(xyzw).as_matrix()
