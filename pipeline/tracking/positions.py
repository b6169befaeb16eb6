"""A person's joints in space, from all that was matched to the person."""

from collections.abc import Sequence

import numpy as np

from pipeline.data import Camera, Observations, Timebase, Track3D
from pipeline.geometry.camera import image_from_world
from pipeline.geometry.life import record_life
from pipeline.geometry.tracks import triangulate_frames
from pipeline.tracking.observations import Sampled


def locate(
    cameras: Sequence[Camera], sampled: Sampled, timebase: Timebase, min_score: float
) -> tuple[Track3D, Observations] | None:
    """Triangulate robustly; observations with a score below ``min_score`` are not used.

    Returns
    -------
        See ``record_life``.
    """
    projections = np.array([image_from_world(camera) for camera in cameras])
    xyz_m = triangulate_frames(projections, sampled.ideal_px, sampled.score, min_score)
    return record_life(cameras, timebase, sampled.start_frame, xyz_m, sampled.seen_px, sampled.score, min_score)
