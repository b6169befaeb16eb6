"""Association baseline: detections of an instant matched in pairs of views (Chen et al. 2020, algorithm 2)."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Int

from pipeline.association.tracking.initialization import Unmatched, group_unmatched
from pipeline.association.tracking.observations import NOBODY, gather, undistorted
from pipeline.association.tracking.parameters import TrackingParameters
from pipeline.association.tracking.tracker import make_rig
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections


def associate_pairwise(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    parameters: TrackingParameters,
) -> dict[str, Int[np.ndarray, " _"]]:
    """Group the detections of each frame number across views by epipolar affinity and graph partitioning.

    Frames are independent: a group is a person of a single frame. Returns the identity of each detection by camera
    name, see ``associate.associate``; each group has a new one.
    """
    bodies = gather(cameras, times, detections)
    ideal_px = undistorted(cameras, bodies)
    score = np.where(bodies.score >= parameters.min_score, bodies.score, 0.0)
    fundamental = make_rig(cameras).fundamental
    identity = np.full(len(bodies.frame), NOBODY)
    num_groups = 0
    for frame in np.unique(bodies.frame):
        pool = [
            Unmatched(
                int(bodies.camera[row]),
                row,
                float(bodies.time_s[row]),
                np.where(score[row][:, None] > 0, ideal_px[row], np.nan),
                score[row],
            )
            for row in np.flatnonzero(bodies.frame == frame).tolist()
        ]
        for group in group_unmatched(pool, fundamental, parameters.alpha_epipolar_px).people:
            identity[[body.row for body in group]] = num_groups
            num_groups += 1
    return {camera.name: identity[bodies.camera == number] for number, camera in enumerate(cameras)}
