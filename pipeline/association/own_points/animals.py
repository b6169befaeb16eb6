"""Track animals: bodies whose points are all the user's own.

Cross-view tracking (Chen et al. 2020) takes any points. Its thresholds are lengths of people, so the world is enlarged
until the animals are as large as people, and made small again afterwards.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.association.own_points.triangulate_points import locate_points
from pipeline.association.tracking.observations import Detections2D, gather
from pipeline.association.tracking.track_people import track_bodies
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.own_points import OwnDetections, SceneObject
from pipeline.core.data.people import Track3D
from pipeline.core.data.rigid import Rigid3

# Extent of a person in a picture, as the larger side of the box, to which animals are compared.
_PERSON_M = 1.5
# Largest enlargement: for animals of unknown size, or as small as a fly.
_MAX_SCALE = 1000.0


def track_animals(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], timebase: Timebase, own: OwnDetections
) -> tuple[SceneObject, ...]:
    """Track animals, and locate their points in the frames of the take; none without animals.

    Positions and standard deviations are in metres, NaN where a point is unknown.
    """
    bodies = gather(cameras, times, own.of_animals) if own.of_animals else None
    if bodies is None or not len(bodies.frame):
        return ()
    scale = _scale(cameras, bodies)
    enlarged = _enlarged(cameras, scale)
    parameters = derive_parameters(enlarged, timebase.frame_rate_hz)
    parameters = replace(parameters, confirm_instants=min(parameters.confirm_instants, timebase.num_frames))
    found = track_bodies(enlarged, times, bodies, timebase, parameters)
    animals = []
    for number, (track, seen) in enumerate(zip(found.tracks, found.observations, strict=True), 1):
        located = locate_points(enlarged, timebase, track, seen.points_px, seen.score, parameters.min_score)
        name = f"animal_{number}"
        points = tuple(f"{name}_{point}" for point in own.names)
        animals.append(SceneObject(name, points, _in_take(located, timebase.num_frames, scale)))
    return tuple(animals)


def _enlarged(cameras: Sequence[Camera], scale: float) -> list[Camera]:
    poses = [camera.cam_from_world for camera in cameras]
    moved = (Rigid3(pose.rotation, pose.translation_m * scale) for pose in poses)
    return [replace(camera, cam_from_world=pose) for camera, pose in zip(cameras, moved, strict=True)]


def _scale(cameras: Sequence[Camera], bodies: Detections2D) -> float:
    """Factor that makes animals as large as people, by their extents in the pictures; 1 for larger ones."""
    known = np.isfinite(bodies.seen_px).all(-1)
    low, high = (np.where(known[..., None], bodies.seen_px, sign * np.inf) for sign in (1, -1))
    extents_px = (high.max(1) - low.min(1)).max(-1)
    extents_px = extents_px[known.sum(1) > 1]
    if not len(extents_px):
        return 1.0
    # Enlarged, no camera is nearer than a metre, within which the pixels of a metre have no meaning.
    enlarged = derive_parameters(_enlarged(cameras, _MAX_SCALE), 1.0)
    scale_px_m = _MAX_SCALE * enlarged.alpha_epipolar_px / enlarged.alpha_3d_m
    extent_m = float(np.median(extents_px)) / scale_px_m
    return float(np.clip(_PERSON_M / max(extent_m, 1e-9), 1.0, _MAX_SCALE))


def _in_take(track: Track3D, num_frames: int, scale: float) -> Track3D:
    """Track over all frames of the take, in the size of the world."""
    unknown = {"xyz_m": np.nan, "error_px": np.nan, "uncertainty_m": np.nan}
    arrays: dict[str, Any] = {}
    for name, array in track.joint_arrays.items():
        whole = np.full((num_frames, *array.shape[1:]), unknown.get(name, 0), array.dtype)
        whole[track.start_frame : track.frames.stop] = array / scale if name in ("xyz_m", "uncertainty_m") else array
        arrays[name] = read_only(whole)
    return replace(track, start_frame=0, **arrays)
