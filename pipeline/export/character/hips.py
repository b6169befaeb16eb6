"""Hips of a character above its standing feet: where its legs have the person's directions.

A foot that stands is put on the floor, up to a centimetre from where it was located. A leg that is nearly straight
would bend visibly for it: its bones turn by the change of its length over its length and the tangent of half its bend.
So hips shift and tilt instead, smoothly. Those of all frames are found at once: they have the smallest sum of squared
angles of thighs, shins and hips, linearised, and of squared second differences (Whittaker's smoother).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded

# Time over which hips follow a leg that is bent at a right angle; straighter legs are followed sooner.
_SMOOTH_S = 0.15
# Least tangent of half a bend: a few millimetres bend straighter legs as much as this one.
_STRAIGHT = 0.05
# Weights of the hips' tilt and of their shift, as a share of the leg's length, beside 1 for the direction of a leg.
_TILT, _SHIFT = 1.0, 0.05


class StandingLeg(NamedTuple):
    """Leg of a character as it would be if the hips were the person's, in the world."""

    hip: Float[np.ndarray, "frames 3"]  # Place of its joint at the hips
    middle: Float[np.ndarray, "frames 3"]  # Place of the middle of the hips
    # Ways from the hip to the knee and from there to the ankle that have the person's directions
    thigh: Float[np.ndarray, "frames 3"]
    shin: Float[np.ndarray, "frames 3"]
    ankle: Float[np.ndarray, "frames 3"]  # Place of the ankle where the foot stands, NaN where it is free


def shift_and_tilt(
    legs: Sequence[StandingLeg], carries: Float[np.ndarray, " frames"], frame_rate_hz: float
) -> tuple[Float[np.ndarray, "frames 3"], Float[np.ndarray, "frames 3"]]:
    """Shift of the hips, and rotation vector (radians) of their tilt about their middle, in each frame.

    Parameters
    ----------
    carries
        Number of hands that stand on the floor: arms turn for hips that shift.
    """
    num_frames = len(carries)
    size = float(np.mean([np.linalg.norm(leg.thigh[0]) + np.linalg.norm(leg.shin[0]) for leg in legs]))
    normal = np.zeros((num_frames, 6, 6))
    normal[:, range(3), range(3)] = _SHIFT + carries[:, None]
    normal[:, range(3, 6), range(3, 6)] = _TILT
    right = np.zeros((num_frames, 6))
    for leg in legs:
        stands = np.isfinite(leg.ankle[:, 0])
        hip, thigh, shin = leg.hip[stands], leg.thigh[stands], leg.shin[stands]
        wanted = leg.ankle[stands] - thigh - shin - hip
        weights = _stiffness(thigh, shin)
        # A joint moves by shift + tilt x its way from the middle.
        moves = np.zeros((len(hip), 3, 6))
        moves[:, range(3), range(3)] = 1.0
        moves[:, :, 3:] = _crossed((leg.middle[stands] - hip) / size)
        weighted = moves.swapaxes(1, 2) @ weights
        normal[stands] += weighted @ moves
        right[stands] += (weighted @ (wanted / size)[..., None])[..., 0]
    found = _smoothest(normal, right, (_SMOOTH_S * frame_rate_hz) ** 4)
    return found[:, :3] * size, found[:, 3:]


def _stiffness(
    thigh: Float[np.ndarray, "frames 3"], shin: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 3 3"]:
    """Quadratic forms of the squared angle of a leg's bones for a way of its end, in lengths of the leg."""
    first, second = (bone / np.linalg.norm(bone, axis=-1, keepdims=True) for bone in (thigh, shin))
    along, across = first + second, np.linalg.norm(first - second, axis=-1)
    # Cosine and sine of half the bend, both doubled.
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
    along = along / length[:, None]
    stiff = 1.0 / ((across / length) ** 2 + _STRAIGHT**2)
    return np.asarray(np.eye(3) + stiff[:, None, None] * along[:, :, None] * along[:, None, :])


def _crossed(vectors: Float[np.ndarray, "frames 3"]) -> Float[np.ndarray, "frames 3 3"]:
    """Matrices of the cross product of vectors with others."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=-2)


def _smoothest(
    normal: Float[np.ndarray, "frames n n"], right: Float[np.ndarray, "frames n"], stiffness: float
) -> Float[np.ndarray, "frames n"]:
    """Values x with the smallest sum of x' normal x / 2 - right x and of squared second differences."""
    num_frames, size = right.shape
    bands = np.zeros((2 * size + 1, num_frames, size))
    for offset in range(size):
        for column in range(size - offset):
            bands[offset, :, column] = normal[:, column + offset, column]
    if num_frames > 2:
        squares = np.zeros((3, num_frames))
        for first in range(3):
            for second in range(first, 3):
                squares[second - first, first : num_frames - 2 + first] += (1, -2, 1)[first] * (1, -2, 1)[second]
        bands[::size] += stiffness * squares[:, :, None]
    return np.asarray(solveh_banded(bands.reshape(2 * size + 1, -1), right.reshape(-1), lower=True)).reshape(
        right.shape
    )
