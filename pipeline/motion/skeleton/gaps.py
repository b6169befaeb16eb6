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


def filled_with_body(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Replace NaN where frames are so far apart that the body may be anywhere: joints move with those that are known.

    A gap is filled linearly, and moved as far as the joints that are known in the frame are from where their own
    neighbours in time have them. Joints that are known in no frame stay NaN.
    """
    filled_m = np.full(xyz_m.shape, np.nan)
    beside_m = np.full(xyz_m.shape, np.nan)
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(np.isfinite(xyz_m[:, joint]).all(-1))
        filled_m[:, joint] = filled_linearly(xyz_m[:, joint], np.full(3, np.nan))
        if len(known) > 1:
            before, behind = np.append(known[1], known[:-1]), np.append(known[1:], known[-2])
            weight = np.divide(known - before, behind - before, out=np.zeros(len(known)), where=behind != before)
            at_m = xyz_m[:, joint]
            expected_m = at_m[before] + weight[:, None].clip(0.0, 1.0) * (at_m[behind] - at_m[before])
            beside_m[known, joint] = at_m[known] - expected_m
    moved_m = np.zeros((len(xyz_m), 1, 3))
    some = np.isfinite(beside_m[..., 0]).any(-1)
    moved_m[some, 0] = np.nanmedian(beside_m[some], axis=1)
    return np.where(np.isfinite(xyz_m), xyz_m, filled_m + moved_m)


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
