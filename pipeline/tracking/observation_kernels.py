"""What each camera saw at the output instants, as compiled loops."""

from typing import no_type_check

import numpy as np

from pipeline.compiled import kernel


@kernel
@no_type_check
def choose_scores(seen_px, score, min_score, found, used):
    """Split scores into those of joints that were found at all, and of joints to use; 0 for the others.

    Parameters
    ----------
    seen_px, score
        (detections, joints[, 2]); NaN where a joint was not found.
    found, used
        Get the scores, (detections, joints).
    """
    for row in range(score.shape[0]):
        for k in range(score.shape[1]):
            is_found = abs(seen_px[row, k, 0] + seen_px[row, k, 1]) < np.inf
            found[row, k] = score[row, k] if is_found else 0.0
            used[row, k] = found[row, k] if found[row, k] >= min_score else 0.0


@kernel
@no_type_check
def _copy(bodies, row, is_distorted, decay, seen_px, ideal_px, score):
    """What a camera saw in one frame; loops of few arrays each, so that they work on several numbers at a time."""
    for k in range(score.shape[0]):
        seen_px[k, 0] = bodies.seen_px[row, k, 0]
        seen_px[k, 1] = bodies.seen_px[row, k, 1]
    if is_distorted:
        for k in range(score.shape[0]):
            ideal_px[k, 0] = bodies.ideal_px[row, k, 0]
            ideal_px[k, 1] = bodies.ideal_px[row, k, 1]
    for k in range(score.shape[0]):
        score[k] = bodies.score[row, k] * decay


@kernel
@no_type_check
def _blend(bodies, left, right, is_distorted, share, decay, seen_px, ideal_px, score):
    """Between two frames of a camera, where both show a joint."""
    for k in range(score.shape[0]):
        value = min(bodies.score[left, k], bodies.score[right, k]) * decay
        if value > 0:
            for axis in range(2):
                one, two = bodies.seen_px[left, k, axis], bodies.seen_px[right, k, axis]
                seen_px[k, axis] = (1 - share) * one + share * two
                if is_distorted:
                    one, two = bodies.ideal_px[left, k, axis], bodies.ideal_px[right, k, axis]
                    ideal_px[k, axis] = (1 - share) * one + share * two
            score[k] = value


@kernel
@no_type_check
def _clear(seen_px, ideal_px, score):
    seen_px[:] = np.nan
    ideal_px[:] = np.nan
    score[:] = 0.0


@kernel
@no_type_check
def sample_observations(rows, bodies, is_distorted, instants_s, half_s, lambda_t_hz, seen_px, ideal_px, score):
    """Find out what each camera saw of a person at the output instants; see ``observations.observations_at``.

    Parameters
    ----------
    rows
        The person's detections, ascending, at most one a camera and frame.
    bodies
        ``observations.Bodies``.
    is_distorted
        Whether ``ideal_px`` is another array than ``seen_px``.
    seen_px, ideal_px, score
        Get the observations, (frames, cameras, joints[, 2]); NaN and 0 where there are none.
    """
    start = 0
    for camera in range(score.shape[1]):
        stop = start
        while stop < len(rows) and bodies.camera[rows[stop]] == camera:
            stop += 1
        after = start
        for frame in range(len(instants_s)):
            ours = seen_px[frame, camera], ideal_px[frame, camera], score[frame, camera]
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
                _copy(bodies, nearest, is_distorted, decay, *ours)
            else:
                _clear(*ours)
            if bodies.frame[right] - bodies.frame[left] == 1 and gap_s > 1e-3 * half_s:
                share = to_left_s / (to_left_s + to_right_s)
                _blend(bodies, left, right, is_distorted, share, decay, *ours)
        start = stop
