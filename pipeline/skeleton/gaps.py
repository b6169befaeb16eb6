"""Gaps in measured points: linear inside, held at the ends."""

import numpy as np
from jaxtyping import Bool, Float


def filled_linearly(
    points: Float[np.ndarray, "frames 3"], default: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "frames 3"]:
    """Replace NaN: linear in time inside, held at the ends, ``default`` where no frame is known."""
    known = np.flatnonzero(np.isfinite(points).all(-1))
    if len(known) == 0:
        return np.broadcast_to(default, points.shape).copy()
    frames = np.arange(len(points))
    return np.column_stack([np.interp(frames, known, points[known, axis]) for axis in range(points.shape[1])])


def carried(
    points: Float[np.ndarray, "frames 3"],
    reference: Float[np.ndarray, "frames 3"],
    default: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "frames 3"]:
    """Replace NaN by letting a point travel with a known one: its offset from there is filled linearly.

    Parameters
    ----------
    reference
        Without NaN.
    default
        Offset from the reference where the point is never known.
    """
    return reference + filled_linearly(points - reference, default)


def gaps_up_to(known: Bool[np.ndarray, "frames joints"], longest: int) -> Bool[np.ndarray, "frames joints"]:
    """Frames in gaps of at most ``longest`` frames, each between two known ones."""
    inside = np.zeros_like(known)
    frames = np.arange(len(known))
    for joint, mine in enumerate(known.T):
        last = np.maximum.accumulate(np.where(mine, frames, -1))
        following = np.minimum.accumulate(np.where(mine, frames, len(known))[::-1])[::-1]
        inside[:, joint] = (last >= 0) & (following < len(known)) & ~mine & (following - last <= longest + 1)
    return inside
