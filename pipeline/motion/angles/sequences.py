"""Angles of sequences of three rotations, continuous in time. All functions are vectorised over frames."""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.motion.angles.definitions import Sequence

_MIRROR = np.diag([1.0, 1.0, -1.0])
_FULL = 2.0 * np.pi
# Sine of the angle between the first and the third axis (10 degrees) below which their angles are told apart poorly.
_LOCKED_SINE = float(np.sin(np.radians(10.0)))


def mirrored(rotation: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotations in the mirror that exchanges left and right: Z is the axis to the right."""
    return np.asarray(_MIRROR @ rotation @ _MIRROR)


def angles_rad(rotation: Float[np.ndarray, "*batch 3 3"], sequence: Sequence) -> Float[np.ndarray, "*batch 3"]:
    """Angles of a sequence of rotations, each about an axis of the frame that the rotations before it have turned.

    ``rotation`` are ``proximal_from_distal``. The second angle is in [-90, 90] degrees, or in [-180, 0] if the first
    and the third axis are the same; the others are in [-180, 180]. Where the sequence is locked, the first and the
    third angle are arbitrary. NaN where the rotation has NaN.
    """
    first, second, third = sequence
    other = 3 - first - second
    sign = 1.0 if (second - first) % 3 == 1 else -1.0
    entry = rotation[..., first, :]
    if first == third:
        # R = R1(a) R2(b) R1(c): the first row is (cos b, sin b sin c, s sin b cos c), the first column likewise.
        beta = -np.arccos(np.clip(entry[..., first], -1.0, 1.0))
        alpha = np.arctan2(-rotation[..., second, first], sign * rotation[..., other, first])
        gamma = np.arctan2(-entry[..., second], -sign * entry[..., other])
    else:
        # R = R1(a) R2(b) R3(c): the entry of the first row and the third column is s sin b.
        beta = np.arcsin(np.clip(sign * entry[..., third], -1.0, 1.0))
        alpha = np.arctan2(-sign * rotation[..., second, third], rotation[..., third, third])
        gamma = np.arctan2(-sign * entry[..., second], entry[..., first])
    return np.stack([alpha, beta, gamma], axis=-1)


def is_locked(rotation: Float[np.ndarray, "*batch 3 3"], sequence: Sequence) -> Bool[np.ndarray, "*batch"]:
    """Tell where the first and the third axis are within 10 degrees of each other, so that only their sum is known."""
    entry = np.clip(rotation[..., sequence[0], sequence[2]], -1.0, 1.0)
    return np.sqrt(1.0 - entry**2) < _LOCKED_SINE


def continuous(angle_rad: Float[np.ndarray, "frames 3"], is_proper: bool) -> Float[np.ndarray, "frames 3"]:
    """Angles that don't jump where rotations don't, and may therefore leave their principal ranges.

    Two triples of angles make the same rotation. Of sequences of three axes the one that is nearest to the frame before
    is taken, so that an arm that is raised aside and on overhead is abducted by more than 90 degrees; in the first
    frame the one with the smaller angles. Of sequences whose first and third axis are the same (``is_proper``) the
    second angle keeps its range. Frames with NaN stay NaN, and the next one is continuous with the last one before
    them.
    """
    known = np.isfinite(angle_rad).all(-1)
    found = angle_rad[known]
    if len(found) and not is_proper:
        other = np.stack([found[:, 0] + np.pi, np.pi - found[:, 1], found[:, 2] + np.pi], axis=-1)
        same = np.linalg.norm(_wrapped(np.diff(found, axis=0)), axis=-1)
        crossed = np.linalg.norm(_wrapped(other[1:] - found[:-1]), axis=-1)
        starts_other = np.linalg.norm(_wrapped(other[0])) < np.linalg.norm(found[0])
        is_other = np.logical_xor.accumulate(np.concatenate([[starts_other], crossed < same]))
        found = np.where(is_other[:, None], other, found)
        found[0] = _wrapped(found[0])
    unwrapped = np.full_like(angle_rad, np.nan)
    unwrapped[known] = np.unwrap(found, axis=0)
    return unwrapped


def _wrapped(angle_rad: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """Angles in [-180, 180] degrees."""
    return angle_rad - _FULL * np.round(angle_rad / _FULL)
