"""Values at the frames of a file, of which the frames of a person are a part: held, or unknown outside of them."""

import numpy as np
from jaxtyping import Bool, Float, Shaped

from pipeline.core.data.people import Track3D


def held(
    values: Shaped[np.ndarray, "rows *columns"], of_frames: range, frames: range
) -> Shaped[np.ndarray, "frames *columns"]:
    """Values at some frames from values of ``of_frames``, of which the nearest one holds before and after them.

    Frames of ``of_frames`` alone are a view.
    """
    if of_frames.start <= frames.start and frames.stop <= of_frames.stop:
        return values[frames.start - of_frames.start : frames.stop - of_frames.start]
    return values[np.clip(np.arange(frames.start, frames.stop) - of_frames.start, 0, len(of_frames) - 1)]


def unknown_outside(
    values: Float[np.ndarray, "rows *columns"], of_frames: range, frames: range
) -> Float[np.ndarray, "frames *columns"]:
    """Values at some frames from values of ``of_frames``, NaN before and after them."""
    found = np.full((len(frames), *values.shape[1:]), np.nan)
    inside = range(max(frames.start, of_frames.start), min(frames.stop, of_frames.stop))
    if inside:
        rows = slice(inside.start - of_frames.start, inside.stop - of_frames.start)
        found[inside.start - frames.start : inside.stop - frames.start] = values[rows]
    return found


def presence(track: Track3D, frames: range) -> Bool[np.ndarray, " frames"]:
    """Frames in which the person is there: any joint has a position."""
    is_there = np.zeros(len(frames), bool)
    known = np.isfinite(track.xyz_m).all(-1).any(-1)
    is_there[np.flatnonzero(known) + track.start_frame - frames.start] = True
    return is_there
