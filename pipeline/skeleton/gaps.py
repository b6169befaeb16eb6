"""Fill gaps in measured points: linear between known frames, constant at the ends."""

import numpy as np
from jaxtyping import Bool, Float


def filled_linearly(
    points: Float[np.ndarray, "frames 3"], default: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "frames 3"]:
    """Replace NaN: linear between known frames, constant at the ends, ``default`` if no frame is known."""
    known = np.flatnonzero(np.isfinite(points).all(-1))
    if len(known) == 0:
        return np.broadcast_to(default, points.shape).copy()
    frames = np.arange(len(points))
    return np.column_stack([np.interp(frames, known, points[known, axis]) for axis in range(points.shape[1])])


def filled_relative_to(
    points: Float[np.ndarray, "frames 3"],
    reference: Float[np.ndarray, "frames 3"],
    default: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "frames 3"]:
    """Replace NaN by moving a point with a reference point: the offset between both is filled linearly.

    ``reference`` has no NaN; ``default`` is the offset if the point is known in no frame.
    """
    return reference + filled_linearly(points - reference, default)


def gaps_up_to(known: Bool[np.ndarray, "frames joints"], longest: int) -> Bool[np.ndarray, "frames joints"]:
    """Mark frames in gaps of at most ``longest`` frames between two known frames."""
    inside = np.zeros_like(known)
    frames = np.arange(len(known))
    for joint, is_known in enumerate(known.T):
        last = np.maximum.accumulate(np.where(is_known, frames, -1))
        following = np.minimum.accumulate(np.where(is_known, frames, len(known))[::-1])[::-1]
        inside[:, joint] = (last >= 0) & (following < len(known)) & ~is_known & (following - last <= longest + 1)
    return inside
