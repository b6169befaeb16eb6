"""Detections of each person, from the observations that association left behind each track."""

import numpy as np
from jaxtyping import Float, Int

from pipeline.data.cameras import Timebase
from pipeline.data.people import Observations, People, Track3D
from pipeline.tracking.observations import NOBODY, Bodies

# Distance of a joint from the person's observation at which it counts by half, as a share of the body's size. An
# observation between two frames of a camera lies between two detections.
_REACH_SHARE = 0.05
# Least number of joints that agree.
_LEAST_ALIKE = 2.0


def owners(people: People, bodies: Bodies, timebase: Timebase) -> Int[np.ndarray, " detections"]:
    """Find the person of each detection: the one whose observations in the camera have the detection's joints.

    Parameters
    ----------
    people
        Tracks and observations of the body's joints.
    bodies
        Detections with the same joints.
    timebase
        Output frames of the tracks.

    Returns
    -------
        Position of the person in ``people.tracks`` for each detection, ``NOBODY`` if it has nobody's joints.
    """
    nearest = np.rint((bodies.time_s - timebase.start_time_s) * timebase.frame_rate_hz).astype(np.int64)
    size_px = _sizes_px(bodies.seen_px)
    owner = np.full(len(bodies.camera), NOBODY)
    most_alike = np.full(len(bodies.camera), _LEAST_ALIKE)
    for number, (track, seen) in enumerate(zip(people.tracks, people.observations, strict=True)):
        for camera in range(seen.score.shape[1]):
            rows = _rows_in(track, camera, bodies, nearest)
            alike = _alike(seen, nearest[rows] - track.start_frame, camera, bodies.seen_px[rows], size_px[rows])
            better = alike > most_alike[rows]
            owner[rows[better]] = number
            most_alike[rows[better]] = alike[better]
    return owner


def _rows_in(
    track: Track3D, camera: int, bodies: Bodies, nearest: Int[np.ndarray, " detections"]
) -> Int[np.ndarray, " rows"]:
    """Detections of a camera in the frames of a track; a camera's detections are in order of time."""
    start, stop = np.searchsorted(bodies.camera, [camera, camera + 1])
    of_camera = nearest[start:stop]
    first, last = np.searchsorted(of_camera, [track.start_frame, track.start_frame + track.num_frames])
    return np.arange(start + first, start + last)


def _sizes_px(points_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, " n"]:
    """Longer side of the box around each body's joints; at least a pixel."""
    found = np.isfinite(points_px)
    low = np.where(found, points_px, np.inf).min(1, initial=np.inf)
    high = np.where(found, points_px, -np.inf).max(1, initial=-np.inf)
    return np.maximum((high - low).max(-1), 1.0)


def _alike(
    seen: Observations,
    frame: Int[np.ndarray, " n"],
    camera: int,
    points_px: Float[np.ndarray, "n joints 2"],
    size_px: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Number of joints that agree with the observations of a camera; a joint at some distance counts in part."""
    apart = np.linalg.norm(seen.points_px[frame, camera] - points_px, axis=-1) / (_REACH_SHARE * size_px[:, None])
    return np.asarray(np.where(np.isfinite(apart), 1.0 / (1.0 + apart**2), 0.0).sum(-1))
