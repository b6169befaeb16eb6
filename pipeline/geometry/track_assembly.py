"""Build tracks and observations from the positions of people over time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.arrays import no_detections, read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Track3D
from pipeline.geometry.kernels import fill_gaps
from pipeline.geometry.tracks import reproject

# Longest gap of a joint that is interpolated.
_MAX_GAP_S = 0.2
# Shortest time for which two cameras must see a person: at least two frames, half of the session if that is shorter. A
# picture is enough where the next one is later.
_MIN_LIFE_S = 0.15

Person = tuple[Track3D, Observations]
Errors = tuple[Float[np.ndarray, "frames joints"], Float[np.ndarray, "frames joints"], Int[np.ndarray, "frames joints"]]


def record_life(
    cameras: Sequence[Camera],
    timebase: Timebase,
    start_frame: int,
    xyz_m: Float[np.ndarray, "frames joints 3"],
    seen_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    min_score: float,
    detection: Int[np.ndarray, "recorded recorded_cameras"] | None = None,
) -> Person | None:
    """Build track and observations of a person: fill short gaps and measure the reprojection error.

    - ``start_frame``: output frame of the first row.
    - ``xyz_m``: world positions in metres, NaN where a joint was not located; changed in place.
    - ``seen_px``, ``score``: observations of the person in distorted pixels, and their scores.
    - ``min_score``: observations with a lower score were not used.
    - ``detection``: see ``Observations``; ``None``: not recorded.
    - Returns track and observations with number 0, from the first to the last frame with a located joint; ``None`` if
      these frames are too few for a person.
    """
    life = find_life(timebase, xyz_m)
    if life is None:
        return None
    xyz_m, seen_px, score = xyz_m[life], seen_px[life], score[life]
    source = close_gaps(timebase, xyz_m)
    errors = reproject(cameras, xyz_m, seen_px, score, min_score)
    return make_person(
        start_frame + life.start,
        xyz_m,
        source,
        errors,
        seen_px,
        score,
        None if detection is None else detection[life],
    )


def find_life(timebase: Timebase, xyz_m: Float[np.ndarray, "frames joints 3"]) -> slice | None:
    """Frames from the first to the last frame with a located joint; ``None`` if they are too few for a person."""
    alive = np.flatnonzero(np.isfinite(xyz_m[..., 0]).any(-1))
    shortest = max(1.0, _MIN_LIFE_S * timebase.frame_rate_hz)
    if len(alive) < min(shortest, max(min(2, timebase.num_frames), timebase.num_frames / 2)):
        return None
    return slice(int(alive[0]), int(alive[-1]) + 1)


def close_gaps(timebase: Timebase, xyz_m: Float[np.ndarray, "frames joints 3"]) -> Int[np.ndarray, "frames joints"]:
    """Fill short gaps of joints in place; return the source of each joint, of ``data.people.Source``."""
    source = np.empty(xyz_m.shape[:2], np.int8)
    fill_gaps(xyz_m, round(_MAX_GAP_S * timebase.frame_rate_hz), np.full(xyz_m.shape[1], -1), source)
    return source


def make_person(
    start_frame: int,
    xyz_m: Float[np.ndarray, "frames joints 3"],
    source: Int[np.ndarray, "frames joints"],
    errors: Errors,
    seen_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    detection: Int[np.ndarray, "recorded recorded_cameras"] | None = None,
) -> Person:
    """Make track and observations, with number 0, of a person's whole life.

    ``errors`` are results of ``tracks.reproject``; ``detection`` is as in ``Observations``, ``None`` if not recorded.
    """
    error_px, mean_score, views = errors
    track = Track3D(
        track_id=0,
        start_frame=start_frame,
        xyz_m=read_only(xyz_m),
        score=read_only(mean_score),
        source=read_only(source),
        error_px=read_only(error_px),
        views=read_only(views),
    )
    rows = no_detections() if detection is None else read_only(detection)
    return track, Observations(0, read_only(seen_px), read_only(score), rows)


def number_people(people: Sequence[Person]) -> tuple[tuple[Track3D, ...], tuple[Observations, ...]]:
    """Sort people by their first frame and number them from 1."""
    ordered = sorted(people, key=lambda pair: pair[0].start_frame)
    return (
        tuple(
            Track3D(k, track.start_frame, track.xyz_m, track.score, track.source, track.error_px, track.views)
            for k, (track, _) in enumerate(ordered, start=1)
        ),
        tuple(replace(seen, track_id=k) for k, (_, seen) in enumerate(ordered, start=1)),
    )
