"""Compiled loops that sample a person's observations at the output instants, and compute positions and errors.

A frame is computed as soon as it is sampled, while its observations are in the processor's cache.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.core.runtime.jit import inlined, kernel, prefetch_row
from pipeline.geometry.camera_kernels import reproject_frame
from pipeline.geometry.kernels import guess_from_neighbours, settle_frame, triangulate_frame


@kernel
@no_type_check
def clear_unfound(seen_px, score):
    """Set the scores of joints that were not found to 0, in place.

    The arrays are (detections, joints, 2) and (detections, joints); pixels are NaN where a joint was not found.
    """
    for row in range(score.shape[0]):
        for k in range(score.shape[1]):
            is_found = abs(seen_px[row, k, 0] + seen_px[row, k, 1]) < np.inf
            score[row, k] = score[row, k] if is_found else 0.0


@kernel
@no_type_check
def keep_used(score, min_score, used):
    """Copy the scores that are at least ``min_score`` to ``used``, and set the others to 0 there."""
    for row in range(score.shape[0]):
        for k in range(score.shape[1]):
            used[row, k] = score[row, k] if score[row, k] >= min_score else 0.0


@inlined
@no_type_check
def _copy(bodies, flat_px, row, decay, sampled_px, score):
    """Copy the joints of one frame; loops over few arrays, so that they are vectorised."""
    for k in range(len(sampled_px)):
        sampled_px[k] = flat_px[row, k]
    for k in range(len(score)):
        score[k] = bodies.score[row, k] * decay


@inlined
@no_type_check
def _blend(bodies, flat_px, left, right, share, decay, sampled_px, score):
    """Interpolate between two frames of a camera where both show a joint."""
    for k in range(len(score)):
        value = min(bodies.score[left, k], bodies.score[right, k]) * decay
        if value > 0:
            for k2 in range(2 * k, 2 * k + 2):
                sampled_px[k2] = (1 - share) * flat_px[left, k2] + share * flat_px[right, k2]
            score[k] = value


@inlined
@no_type_check
def _clear(sampled_px, score):
    sampled_px[:] = np.nan
    score[:] = 0.0


class Sampling(NamedTuple):
    """One person's detections, and how they are sampled; see ``observations.sampling``."""

    start_frame: int  # output frame of the first instant
    rows: np.ndarray  # rows of the detections, ascending, at most one a camera and frame
    seen_s: np.ndarray  # time of each row
    seen_frame: np.ndarray  # the camera's frame number of each row
    first: np.ndarray  # (cameras + 1,): place of each camera's first row in rows; the last entry is their number
    cursor: np.ndarray  # (cameras,): place of the first row that is not before the instant; moved by the kernels
    instants_s: np.ndarray  # (frames,): output instants, ascending
    half_s: float  # half a period of the output
    lambda_t_hz: float


@inlined
@no_type_check
def _sample_frame(sampling, frame, bodies, flat_px, sampled_px, score):
    """Sample a person's observations in each camera at an output instant; see ``Sampling``.

    An instant between two consecutive frames of a camera takes their linear interpolation, so that cameras that are not
    synchronised agree on the instant. Its score falls with the distance to the nearer frame as the weight of old
    observations does, ``exp(-lambda_t |t - t_i|)`` (Chen et al. 2020, eq. 11). Where a neighbour is missing, a frame
    within half a period stands for the instant. Missed frames are not interpolated.

    ``bodies``: ``observations.Detections2D``. ``flat_px``: joints of all detections, x and y of each in turn,
    (detections, 2 * joints). ``sampled_px``, ``score``: outputs (cameras, 2 * joints) and (cameras, joints); NaN and 0
    without an observation.
    """
    rows, time_s = sampling.rows, sampling.instants_s[frame]
    for camera in range(score.shape[0]):
        ours = sampled_px[camera], score[camera]
        start, stop, after = sampling.first[camera], sampling.first[camera + 1], sampling.cursor[camera]
        if start == stop:
            _clear(*ours)
            continue
        while after < stop and sampling.seen_s[after] < time_s:
            after += 1
        sampling.cursor[camera] = after
        upcoming = rows[min(after + 1, stop - 1)]
        prefetch_row(flat_px, upcoming)
        prefetch_row(bodies.score, upcoming)
        right = min(after, stop - 1)
        is_exact = after < stop and sampling.seen_s[right] == time_s
        left = right if is_exact else max(after - 1, start)
        to_left_s, to_right_s = abs(time_s - sampling.seen_s[left]), abs(sampling.seen_s[right] - time_s)
        nearest, gap_s = (left, to_left_s) if to_left_s <= to_right_s else (right, to_right_s)
        decay = np.exp(-sampling.lambda_t_hz * gap_s) if gap_s > 0 else 1.0
        if gap_s <= sampling.half_s:
            _copy(bodies, flat_px, rows[nearest], decay, *ours)
        else:
            _clear(*ours)
        if sampling.seen_frame[right] - sampling.seen_frame[left] == 1 and gap_s > 1e-3 * sampling.half_s:
            share = to_left_s / (to_left_s + to_right_s)
            _blend(bodies, flat_px, rows[left], rows[right], share, decay, *ours)


@inlined
@no_type_check
def _rewind(sampling):
    """Set the cursors to the first rows."""
    for camera in range(len(sampling.cursor)):
        sampling.cursor[camera] = sampling.first[camera]


@kernel
@no_type_check
def locate(sampling, bodies, ideal_px, solver, sampled_px, score, xyz_m, disputed, guess_m):
    """Triangulate a person at the output instants, as ``tracks.triangulate_frames`` does.

    - ``bodies``, ``ideal_px``: ``observations.Detections2D``, and their undistorted joints, (detections, 2 * joints).
    - ``solver``: ``geometry.kernels.Solver``.
    - ``sampled_px``, ``score``: workspace, (cameras, 2 * joints) and (cameras, joints).
    - ``xyz_m``: output: world coordinates in metres, (frames, joints, 3), NaN where fewer than two cameras see the
      point.
    - ``disputed``, ``guess_m``: workspace, (frames, joints) and (frames, joints, 3).
    """
    _rewind(sampling)
    for frame in range(len(xyz_m)):
        _sample_frame(sampling, frame, bodies, ideal_px, sampled_px, score)
        triangulate_frame(solver, sampled_px, score, xyz_m[frame], disputed[frame])
    guess_from_neighbours(solver, xyz_m, disputed, guess_m)
    _rewind(sampling)
    for frame in range(len(xyz_m)):
        if np.any(disputed[frame]):
            _sample_frame(sampling, frame, bodies, ideal_px, sampled_px, score)
            settle_frame(solver, sampled_px, score, disputed[frame], guess_m[frame], xyz_m[frame])


@kernel
@no_type_check
def record(sampling, bodies, seen_px, lenses, xyz_m, sampled_px, score, error_px, mean_score, views):
    """Sample a person's observations as seen, and measure the reprojection errors of the person's positions.

    - ``bodies``, ``seen_px``: ``observations.Detections2D``, and their joints as seen, (detections, 2 * joints).
    - ``lenses``: ``geometry.camera_kernels.Lenses``.
    - ``xyz_m``: world coordinates in metres, (frames, joints, 3), NaN where unknown.
    - ``sampled_px``, ``score``: outputs (frames, cameras, 2 * joints) and (frames, cameras, joints); NaN and 0 without
      an observation.
    - ``error_px``, ``mean_score``, ``views``: outputs (frames, joints) of ``tracks.reproject``.
    """
    _rewind(sampling)
    for frame in range(len(xyz_m)):
        ours = sampled_px[frame], score[frame]
        _sample_frame(sampling, frame, bodies, seen_px, *ours)
        reproject_frame(lenses, xyz_m[frame], *ours, error_px[frame], mean_score[frame], views[frame])


@kernel
@no_type_check
def sample(sampling, bodies, seen_px, sampled_px, score):
    """Sample a person's observations as seen at the output instants.

    ``bodies``, ``seen_px``: ``observations.Detections2D``, and their joints as seen, (detections, 2 * joints).
    ``sampled_px``, ``score``: outputs (frames, cameras, 2 * joints) and (frames, cameras, joints); NaN and 0 without an
    observation.
    """
    _rewind(sampling)
    for frame in range(len(score)):
        _sample_frame(sampling, frame, bodies, seen_px, sampled_px[frame], score[frame])
