"""A person's joints in space, from all that was matched to the person."""

from collections.abc import Sequence

import numpy as np

from pipeline.data import Camera, Observations, Timebase, Track3D, read_only
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.tracks import reproject, triangulate_frames
from pipeline.tracking.observation_kernels import fill_gaps
from pipeline.tracking.observations import Sampled

# A joint that is away for no longer than this is interpolated.
_MAX_GAP_S = 0.2
# A person must have been seen by two cameras for as long.
_MIN_LIFE_S = 0.15


def locate(
    cameras: Sequence[Camera], sampled: Sampled, timebase: Timebase, min_score: float
) -> tuple[Track3D, Observations] | None:
    """Triangulate robustly, fill short gaps and measure the reprojection error.

    Parameters
    ----------
    min_score
        Observations with less are not used.

    Returns
    -------
        Track and observations, cut to the frames in which a joint could be located and with number 0; ``None`` where
        that is too short a life to be a person.
    """
    projections = np.array([image_from_world(camera) for camera in cameras])
    xyz_m = triangulate_frames(projections, sampled.ideal_px, sampled.score, min_score)
    alive = np.flatnonzero(np.isfinite(xyz_m[..., 0]).any(-1))
    if len(alive) < max(2, _MIN_LIFE_S * timebase.frame_rate_hz):
        return None
    life = slice(alive[0], alive[-1] + 1)
    xyz_m, points_px, score = xyz_m[life], sampled.seen_px[life], sampled.score[life]
    source = np.empty(xyz_m.shape[:2], np.int8)
    fill_gaps(xyz_m, round(_MAX_GAP_S * timebase.frame_rate_hz), np.full(xyz_m.shape[1], -1), source)
    error_px, mean_score, views = reproject(cameras, xyz_m, points_px, score, min_score)
    track = Track3D(
        track_id=0,
        start_frame=sampled.start_frame + int(alive[0]),
        xyz_m=read_only(xyz_m),
        score=read_only(mean_score),
        source=read_only(source),
        error_px=read_only(error_px),
        views=read_only(views),
    )
    return track, Observations(0, read_only(points_px), read_only(score))
