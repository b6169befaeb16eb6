"""Compiled smoothing of motions by local lines."""

from typing import no_type_check

import numpy as np

from pipeline.core.runtime.jit import kernel

# Tolerance of frames at the wanted time itself.
_SAME_S = 1e-9


@kernel
@no_type_check
def fit_local_lines(times_s, points, wanted_s, kernel_s, reach, limit_s, weights, value, slope):
    """Fit a line to each joint around each wanted time, with Gaussian weights.

    - ``times_s``, ``points``: times of the frames, and joints in them, (frames, joints, 2), NaN where unseen.
    - ``wanted_s``: times in ascending order.
    - ``kernel_s``: standard deviation of the weights.
    - ``reach``: number of frames on each side.
    - ``limit_s``: a joint must be seen so near, before and after.
    - ``weights``: workspace, (2 * reach,).
    - ``value``, ``slope``: outputs, (steps, joints, 2), NaN in gaps and beyond the frames.
    """
    nearest = 0
    for step in range(len(wanted_s)):
        while nearest < len(times_s) and times_s[nearest] < wanted_s[step]:
            nearest += 1
        first, stop = max(nearest - reach, 0), min(nearest + reach, len(times_s))
        for row in range(first, stop):
            weights[row - first] = np.exp(-0.5 * ((times_s[row] - wanted_s[step]) / kernel_s) ** 2)
        for joint in range(points.shape[1]):
            s0, s1, s2 = 0.0, 0.0, 0.0
            t0_x, t1_x, t0_y, t1_y = 0.0, 0.0, 0.0, 0.0
            before, after = False, False
            for row in range(first, stop):
                x, y = points[row, joint, 0], points[row, joint, 1]
                if x != x or y != y:
                    continue
                apart_s, weight = times_s[row] - wanted_s[step], weights[row - first]
                before |= -limit_s < apart_s <= _SAME_S
                after |= -_SAME_S <= apart_s < limit_s
                s0 += weight
                s1 += weight * apart_s
                s2 += weight * apart_s * apart_s
                t0_x += weight * x
                t1_x += weight * apart_s * x
                t0_y += weight * y
                t1_y += weight * apart_s * y
            spread = s0 * s2 - s1 * s1
            is_known = before and after and spread > 1e-3 * (s0 * kernel_s) ** 2
            over = 1.0 / spread if is_known else np.nan
            value[step, joint, 0], value[step, joint, 1] = (
                (s2 * t0_x - s1 * t1_x) * over,
                (s2 * t0_y - s1 * t1_y) * over,
            )
            slope[step, joint, 0], slope[step, joint, 1] = (
                (s0 * t1_x - s1 * t0_x) * over,
                (s0 * t1_y - s1 * t0_y) * over,
            )
