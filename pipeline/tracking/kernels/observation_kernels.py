"""Compiled loops that sample a person's observations at the output instants."""

from typing import no_type_check

import numpy as np

from pipeline.runtime.jit import kernel


@kernel
@no_type_check
def clear_unfound(seen_px, score):
    """Set the scores of joints that were not found to 0, in place.

    Parameters
    ----------
    seen_px, score
        Arrays (detections, joints, 2) and (detections, joints); pixels are NaN where a joint was not found.
    """
    for row in range(score.shape[0]):
        for k in range(score.shape[1]):
            is_found = abs(seen_px[row, k, 0] + seen_px[row, k, 1]) < np.inf
            score[row, k] = score[row, k] if is_found else 0.0


@kernel
@no_type_check
def _copy(bodies, points_px, row, decay, sampled_px, score):
    """Copy the joints of one frame; loops over few arrays, so that they are vectorised."""
    for k in range(score.shape[0]):
        sampled_px[k, 0] = points_px[row, k, 0]
        sampled_px[k, 1] = points_px[row, k, 1]
    for k in range(score.shape[0]):
        score[k] = bodies.score[row, k] * decay


@kernel
@no_type_check
def _blend(bodies, points_px, left, right, share, decay, sampled_px, score):
    """Interpolate between two frames of a camera where both show a joint."""
    for k in range(score.shape[0]):
        value = min(bodies.score[left, k], bodies.score[right, k]) * decay
        if value > 0:
            for axis in range(2):
                one, two = points_px[left, k, axis], points_px[right, k, axis]
                sampled_px[k, axis] = (1 - share) * one + share * two
            score[k] = value


@kernel
@no_type_check
def _clear(sampled_px, score):
    sampled_px[:] = np.nan
    score[:] = 0.0


@kernel
@no_type_check
def sample_observations(rows, bodies, points_px, instants_s, half_s, lambda_t_hz, sampled_px, score):
    """Sample a person's observations in each camera at the output instants; see ``observations.observations_at``.

    Parameters
    ----------
    rows
        Rows of the person's detections, ascending, at most one a camera and frame.
    bodies
        ``observations.Bodies``.
    points_px
        Joints of all detections, (detections, joints, 2).
    sampled_px, score
        Output arrays (frames, cameras, joints, 2) and (frames, cameras, joints); NaN and 0 without an observation.
    """
    start = 0
    for camera in range(score.shape[1]):
        stop = start
        while stop < len(rows) and bodies.camera[rows[stop]] == camera:
            stop += 1
        after = start
        for frame in range(len(instants_s)):
            ours = sampled_px[frame, camera], score[frame, camera]
            if start == stop:
                _clear(*ours)
                continue
            time_s = instants_s[frame]
            while after < stop and bodies.time_s[rows[after]] < time_s:
                after += 1
            right = rows[min(after, stop - 1)]
            is_exact = after < stop and bodies.time_s[right] == time_s
            left = right if is_exact else rows[max(after - 1, start)]
            to_left_s, to_right_s = abs(time_s - bodies.time_s[left]), abs(bodies.time_s[right] - time_s)
            nearest, gap_s = (left, to_left_s) if to_left_s <= to_right_s else (right, to_right_s)
            decay = np.exp(-lambda_t_hz * gap_s) if gap_s > 0 else 1.0
            if gap_s <= half_s:
                _copy(bodies, points_px, nearest, decay, *ours)
            else:
                _clear(*ours)
            if bodies.frame[right] - bodies.frame[left] == 1 and gap_s > 1e-3 * half_s:
                share = to_left_s / (to_left_s + to_right_s)
                _blend(bodies, points_px, left, right, share, decay, *ours)
        start = stop
