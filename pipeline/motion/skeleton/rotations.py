"""Rotations over time: from directions, from points, across gaps. All functions are vectorised over frames."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import solve_banded
from scipy.spatial.transform import Rotation, Slerp

# Shortest vector (metres, or the sine of an angle) with a usable direction.
_NO_DIRECTION = 1e-6
# Smallest sine (3 degrees) of the angle between two axes of a frame; below it, the third axis is noise.
_MIN_AXES_SINE = 0.05

# Sine of the bend (12 degrees) below which the plane of a bent limb is uncertain: noise of centimetres gives as much.
_STRAIGHT_SINE = 0.2
# Time over which the plane of a limb bent at a right angle is averaged. Straighter limbs are averaged over longer
# times.
_TWIST_TIME_S = 0.02
# Weight of zero twist, relative to 1 for a limb bent at a right angle. A limb that is straight for half a second
# returns to zero twist.
_NATURAL_WEIGHT = 0.002


def unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Vectors of length 1; NaN where a vector is too short to have a direction, or NaN."""
    norm = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(norm > _NO_DIRECTION, norm, np.nan)


def times(
    matrices: Float[np.ndarray, "frames 3 3"], other: Float[np.ndarray, "3 *columns"]
) -> Float[np.ndarray, "frames 3 *columns"]:
    """Products of matrices with one other matrix, or with one vector: ten times as fast as ``matrices @ other``."""
    return (matrices.reshape(-1, 3) @ other).reshape(len(matrices), 3, *other.shape[1:])


def swing(
    start: Float[np.ndarray, " 3"], end: Float[np.ndarray, "frames 3"]
) -> tuple[Rotation, Bool[np.ndarray, " frames"]]:
    """Smallest rotations, without twist, from a unit vector to the directions of other vectors.

    ``end`` are of any length, NaN where unknown. Returns the frames in which the rotations are known, too; the identity
    elsewhere. The axis of a half turn is arbitrary but fixed.
    """
    direction = unit(end)
    valid = np.isfinite(direction).all(-1)
    direction = np.where(valid[:, None], direction, start)
    quat = np.column_stack([np.cross(start, direction), 1.0 + direction @ start])
    aside = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
    opposite = np.linalg.norm(quat, axis=-1) < _NO_DIRECTION
    quat[opposite] = (*aside, 0.0)
    return Rotation.from_quat(quat), valid


def from_axes(
    left: Float[np.ndarray, "frames 3"], up: Float[np.ndarray, "frames 3"]
) -> tuple[Rotation, Bool[np.ndarray, " frames"]]:
    """Orientations with the X axis along ``left`` and the Z axis as close to ``up`` as possible.

    Returns rotations from rest to world, and the frames in which they are known. A frame is unknown, with the identity,
    if a vector is NaN or too short, or if both are parallel.
    """
    x = unit(left)
    behind = np.cross(unit(up), x)
    valid = np.linalg.norm(np.where(np.isfinite(behind), behind, 0.0), axis=-1) > _MIN_AXES_SINE
    y = unit(behind)
    matrices = np.stack([x, y, np.cross(x, y)], axis=-1)
    return Rotation.from_matrix(np.where(valid[:, None, None], matrices, np.eye(3)), assume_valid=True), valid


def align(start: Float[np.ndarray, "frames vectors 3"], end: Float[np.ndarray, "frames vectors 3"]) -> Rotation:
    """Rotation of each frame that aligns vectors in the least-squares sense (Kabsch 1976).

    Pairs of vectors with NaN are ignored; the rotation is arbitrary in frames with fewer than two independent pairs.
    """
    # SciPy's ``Rotation.align_vectors`` takes one frame a call: 17 times as long for 2,000 frames of five vectors.
    known = np.isfinite(start + end).all(-1)[..., None]
    covariance = np.einsum("fvi,fvj->fij", np.where(known, end, 0.0), np.where(known, start, 0.0))
    left, _, right = np.linalg.svd(covariance)
    left[..., 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return Rotation.from_matrix(left @ right, assume_valid=True)


def filled(rotation: Rotation, valid: Bool[np.ndarray, " frames"]) -> Rotation:
    """Replace unknown rotations: slerp between known frames, constant at the ends, the identity if none is known."""
    frames = np.flatnonzero(valid)
    if len(frames) == 0:
        return Rotation.identity(len(valid))
    if len(frames) == 1:
        return rotation[np.full(len(valid), frames[0])]
    return Slerp(frames, rotation[frames])(np.clip(np.arange(len(valid)), frames[0], frames[-1]))


def continuous_quat_xyzw(rotation: Rotation) -> Float[np.ndarray, "frames 4"]:
    """Quaternions (x, y, z, w), each on the hemisphere of its predecessor; the first has w >= 0."""
    quat = rotation.as_quat()
    turned = np.einsum("fi,fi->f", quat[1:], quat[:-1]) < 0
    signs = np.cumprod(np.concatenate([[1.0 if quat[0, 3] >= 0 else -1.0], np.where(turned, -1.0, 1.0)]))
    return quat * signs[:, None]


def hinge_twist_rad(
    bone: Float[np.ndarray, " 3"],
    hinge: Float[np.ndarray, " 3"],
    lower: Float[np.ndarray, "frames 3"],
    frame_rate_hz: float,
) -> Float[np.ndarray, " frames"]:
    """Twist of an upper limb about its own axis that moves the lower limb into the plane of its hinge, in radians.

    The unit complex number exp(i twist) is fitted over time by weighted least squares, with a smoothness term
    (Whittaker's smoother) and a weak prior for zero twist. A straight limb has almost no weight, so the twist is
    interpolated from one bend to the next. A bend in the wrong direction has little weight, because elbows and knees
    don't bend backwards. ``bone`` is the rest direction of the upper limb, ``hinge`` an axis at a right angle to it
    about which a positive rotation bends the joint; ``lower`` is the direction of the lower limb in the upper limb's
    frame before twist, of any length, NaN where unknown.
    """
    normal = np.nan_to_num(np.cross(bone, unit(lower)))
    bend = normal @ hinge + 1j * (np.cross(hinge, normal) @ bone)
    sine = np.abs(bend)
    direction = bend / np.maximum(sine, _NO_DIRECTION)
    weight = sine**4 / (sine**2 + _STRAIGHT_SINE**2) * (1.0 + direction.real) / 2.0

    stiffness = (_TWIST_TIME_S * frame_rate_hz) ** 2
    num_neighbours = np.full(len(lower), 2.0)
    num_neighbours[0] -= 1.0
    num_neighbours[-1] -= 1.0
    bands = np.full((3, len(lower)), -stiffness)
    bands[1] = weight + _NATURAL_WEIGHT + stiffness * num_neighbours
    return np.angle(solve_banded((1, 1), bands, weight * direction + _NATURAL_WEIGHT))
