"""Bodies in a camera's pictures that nobody of a take was given."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.cameras import FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Observations, Track3D

# Distance of a body's joints from a person's observations, in diagonals of its box, within which the body is theirs.
# Observations are between two frames of the camera, which take a body a small part of its size further.
_NEAR = 0.1


def is_unmatched(
    detections: Detections,
    times: FrameTimes,
    camera: int,
    timebase: Timebase,
    people: Iterable[tuple[Track3D, Observations]],
) -> Bool[np.ndarray, " n"]:
    """Tell which bodies of a camera no person was given.

    A body is a person's if the median of its joints' distances from those that the person was given of this camera, at
    the nearest output frame, is at most a tenth of the diagonal of the body's box.

    Parameters
    ----------
    times
        Times of the camera's frames.
    camera
        Position of the camera among those of the observations.
    people
        Tracks with the observations behind them.
    """
    frame = np.rint((times.time_s[detections.frame] - timebase.start_time_s) * timebase.frame_rate_hz).astype(int)
    size_px = np.linalg.norm(detections.box_px[:, 2:] - detections.box_px[:, :2], axis=1)
    is_free = np.ones(len(frame), bool)
    for track, observations in people:
        rows = frame - track.start_frame
        bodies = np.flatnonzero((rows >= 0) & (rows < len(observations.points_px)) & is_free)
        given_px = observations.points_px[rows[bodies], camera]
        apart_px = np.linalg.norm(detections.keypoints_px[bodies] - given_px, axis=-1)
        is_free[bodies[_median(apart_px) <= _NEAR * size_px[bodies]]] = False
    return is_free


def _median(values: Float[np.ndarray, "n joints"]) -> Float[np.ndarray, " n"]:
    """Medians of rows, without NaN; infinite where all are."""
    ordered = np.sort(values, axis=1)
    num_known = np.isfinite(values).sum(1)
    middle = ordered[np.arange(len(values)), np.maximum(num_known - 1, 0) // 2]
    return np.where(num_known > 0, middle, np.inf)
