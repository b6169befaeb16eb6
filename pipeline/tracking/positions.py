"""A person's joints in space, from all that was matched to the person."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera, Observations, Source, Timebase, Track3D, read_only
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.tracks import reproject, triangulate_frames
from pipeline.tracking.observations import Sampled

# A joint that is away for no longer than this is interpolated.
_MAX_GAP_S = 0.2
# A person must have been seen by two cameras for as long.
_MIN_LIFE_S = 0.15


def locate(cameras: Sequence[Camera], sampled: Sampled, timebase: Timebase) -> tuple[Track3D, Observations] | None:
    """Triangulate robustly, fill short gaps and measure the reprojection error.

    Returns
    -------
        Track and observations, cut to the frames in which a joint could be located and with number 0; ``None`` where
        that is too short a life to be a person.
    """
    projections = np.array([image_from_world(camera) for camera in cameras])
    xyz_m = triangulate_frames(projections, sampled.ideal_px, sampled.used)
    alive = np.flatnonzero(np.isfinite(xyz_m[..., 0]).any(-1))
    if len(alive) < max(2, _MIN_LIFE_S * timebase.frame_rate_hz):
        return None
    life = slice(alive[0], alive[-1] + 1)
    xyz_m, points_px, score = xyz_m[life], sampled.seen_px[life], sampled.score[life]
    filled_m = fill_gaps(xyz_m, round(_MAX_GAP_S * timebase.frame_rate_hz))
    source = np.full(xyz_m.shape[:2], Source.MEASURED, np.int8)
    source[np.isnan(xyz_m[..., 0])] = Source.INTERPOLATED
    source[np.isnan(filled_m[..., 0])] = Source.ABSENT
    error_px, mean_score, views = reproject(cameras, filled_m, points_px, sampled.used[life])
    track = Track3D(
        track_id=0,
        start_frame=sampled.start_frame + int(alive[0]),
        xyz_m=read_only(filled_m),
        score=read_only(mean_score),
        source=read_only(source),
        error_px=read_only(error_px),
        views=read_only(views),
    )
    return track, Observations(0, read_only(points_px), read_only(score))


def fill_gaps(xyz_m: Float[np.ndarray, "frames joints 3"], max_gap: int) -> Float[np.ndarray, "frames joints 3"]:
    """Interpolate linearly over gaps of at most ``max_gap`` frames between two known positions."""
    missing = np.isnan(xyz_m[..., 0])
    if not missing.any():
        return xyz_m
    filled = xyz_m.copy()
    for joint in np.flatnonzero(missing.any(0)):
        known = np.flatnonzero(~missing[:, joint])
        gaps = np.diff(known)
        for place in np.flatnonzero((gaps > 1) & (gaps <= max_gap + 1)):
            left, right = known[place], known[place + 1]
            share = np.arange(1, right - left)[:, None] / (right - left)
            filled[left + 1 : right, joint] = (1 - share) * xyz_m[left, joint] + share * xyz_m[right, joint]
    return filled
