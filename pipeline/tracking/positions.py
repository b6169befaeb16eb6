"""A person's joints in space, from all that was matched to the person."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera, Observations, Source, Timebase, Track3D, read_only
from pipeline.geometry.camera import image_from_world, project, undistort_px
from pipeline.geometry.triangulation import triangulate_robust
from pipeline.tracking.parameters import TrackingParameters

# A joint that is away for no longer than this is interpolated.
_MAX_GAP_S = 0.2
# A person must have been seen by two cameras for as long.
_MIN_LIFE_S = 0.15
# Frames on each side whose median says where a joint should be.
_NEIGHBOURS = 2
_BLOCK_FRAMES = 64


def locate(
    cameras: Sequence[Camera],
    start_frame: int,
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    score: Float[np.ndarray, "frames cameras joints"],
    timebase: Timebase,
    parameters: TrackingParameters,
) -> tuple[Track3D, Observations] | None:
    """Triangulate robustly, fill short gaps and measure the reprojection error.

    Parameters
    ----------
    points_px
        Observations as seen (distorted), NaN where there is none.

    Returns
    -------
        Track and observations, cut to the frames in which a joint could be located and with number 0; ``None`` where
        that is too short a life to be a person.
    """
    used = np.where(score >= parameters.min_score, score, 0.0)
    alone_m = _triangulate(cameras, points_px, used, None)
    xyz_m = _triangulate(cameras, points_px, used, _running_median(alone_m))

    alive = np.flatnonzero(np.isfinite(xyz_m[..., 0]).any(-1))
    if len(alive) < max(2, _MIN_LIFE_S * timebase.frame_rate_hz):
        return None
    life = slice(alive[0], alive[-1] + 1)
    xyz_m, points_px, score, used = xyz_m[life], points_px[life], score[life], used[life]
    filled_m = fill_gaps(xyz_m, round(_MAX_GAP_S * timebase.frame_rate_hz))
    source = np.select(
        [np.isfinite(xyz_m[..., 0]), np.isfinite(filled_m[..., 0])],
        [Source.MEASURED, Source.INTERPOLATED],
        Source.ABSENT,
    )
    present = np.isfinite(filled_m[..., 0])
    views = (used > 0).sum(1)
    track = Track3D(
        track_id=0,
        start_frame=start_frame + int(alive[0]),
        xyz_m=read_only(filled_m),
        score=read_only(np.where(present, used.sum(1) / np.maximum(views, 1), 0.0)),
        source=read_only(source.astype(np.int8)),
        error_px=read_only(_reprojection_error_px(cameras, filled_m, points_px, used)),
        views=read_only(np.where(present, views, 0)),
    )
    return track, Observations(0, read_only(points_px), read_only(score))


def _triangulate(
    cameras: Sequence[Camera],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    used: Float[np.ndarray, "frames cameras joints"],
    guess_m: Float[np.ndarray, "frames joints 3"] | None,
) -> Float[np.ndarray, "frames joints 3"]:
    """Triangulate block by block: a frame needs some 20 kB on the way."""
    projections = np.array([image_from_world(camera) for camera in cameras])
    xyz_m = np.empty((*points_px.shape[:1], points_px.shape[2], 3))
    for start in range(0, len(points_px), _BLOCK_FRAMES):
        block = slice(start, start + _BLOCK_FRAMES)
        ideal_px = np.stack([undistort_px(camera, points_px[block, c]) for c, camera in enumerate(cameras)], axis=1)
        guess = None if guess_m is None else guess_m[block]
        xyz_m[block] = triangulate_robust(projections, ideal_px, used[block], guess)
    return xyz_m


def _running_median(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Median over each frame and its neighbours, NaN where none of them has the joint."""
    padded = np.pad(xyz_m, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0)
    empty = np.isnan(windows).all(-1)
    return np.where(empty, np.nan, np.nanmedian(np.where(empty[..., None], 0.0, windows), axis=-1))


def fill_gaps(xyz_m: Float[np.ndarray, "frames joints 3"], max_gap: int) -> Float[np.ndarray, "frames joints 3"]:
    """Interpolate linearly over gaps of at most ``max_gap`` frames between two known positions."""
    filled = xyz_m.copy()
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(np.isfinite(xyz_m[:, joint, 0]))
        for left, right in pairwise(known):
            if 1 < right - left <= max_gap + 1:
                share = np.arange(1, right - left)[:, None] / (right - left)
                filled[left + 1 : right, joint] = (1 - share) * xyz_m[left, joint] + share * xyz_m[right, joint]
    return filled


def _reprojection_error_px(
    cameras: Sequence[Camera],
    xyz_m: Float[np.ndarray, "frames joints 3"],
    points_px: Float[np.ndarray, "frames cameras joints 2"],
    used: Float[np.ndarray, "frames cameras joints"],
) -> Float[np.ndarray, "frames joints"]:
    """Mean over the cameras that saw a joint, NaN where none did."""
    error_px = np.stack(
        [np.linalg.norm(project(camera, xyz_m) - points_px[:, c], axis=-1) for c, camera in enumerate(cameras)], axis=1
    )
    counted = (used > 0) & np.isfinite(error_px)
    count = counted.sum(1)
    return np.where(count > 0, np.where(counted, error_px, 0.0).sum(1) / np.maximum(count, 1), np.nan)
