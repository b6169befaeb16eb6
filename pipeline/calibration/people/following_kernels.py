"""Compiled comparison of followed bodies with the bodies of a frame."""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel

# Number of frames over which a velocity is measured.
VELOCITY_FRAMES = 4


@kernel
@no_type_check
def _median(values, count):
    """Sort the first values in place and return their median; NaN without any."""
    for k in range(1, count):
        value, place = values[k], k
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
    return (values[(count - 1) // 2] + values[count // 2]) / 2 if count > 0 else np.nan


@kernel
@no_type_check
def measure_shifts(points_px, time_s, early, last, first, min_joints, values, shift):
    """Measure the shift from the predicted joints of tracklets to bodies, in heights of the body.

    - ``points_px``: joints of all bodies of a camera, (bodies, joints, 2), NaN where a joint is not seen.
    - ``time_s``: times of their frames.
    - ``early``, ``last``: number of each tracklet's last body, and of a body some frames before.
    - ``first``: number of the frame's first body.
    - ``values``: workspace, (3, joints).
    - ``shift``: output: medians over joints that both see, (tracklets, bodies), infinite if they share too few.

    A body is predicted at its mean velocity over the last frames.
    """
    num_joints = points_px.shape[1]
    for row in range(len(last)):
        before, here = points_px[early[row]], points_px[last[row]]
        since_s, ahead_s = time_s[last[row]] - time_s[early[row]], time_s[first] - time_s[last[row]]
        count = 0
        for k in range(num_joints):
            x, y = here[k, 0] - before[k, 0], here[k, 1] - before[k, 1]
            if x == x and y == y:
                values[0, count], values[1, count] = x, y
                count += 1
        per_s = ahead_s / since_s if since_s > 0 and count > 0 else 0.0
        ahead_x, ahead_y = _median(values[0], count) * per_s, _median(values[1], count) * per_s
        ahead_x, ahead_y = ahead_x if count > 0 else 0.0, ahead_y if count > 0 else 0.0
        for column in range(shift.shape[1]):
            body = points_px[first + column]
            left, right, top, bottom, count = np.inf, -np.inf, np.inf, -np.inf, 0
            for k in range(num_joints):
                if body[k, 0] == body[k, 0] and body[k, 1] == body[k, 1]:
                    left, right = min(left, body[k, 0]), max(right, body[k, 0])
                    top, bottom = min(top, body[k, 1]), max(bottom, body[k, 1])
                x, y = here[k, 0] + ahead_x - body[k, 0], here[k, 1] + ahead_y - body[k, 1]
                if x == x and y == y:
                    values[2, count] = np.sqrt(x * x + y * y)
                    count += 1
            height_px = max(right - left, bottom - top, 1.0)
            shift[row, column] = _median(values[2], count) / height_px if count >= min_joints else np.inf
