"""Compiled loops that find the detections that can't be a target's, so that their affinities are not computed.

A plane through the camera and a side of a detection's box in the image separates the detection's rays from all that is
beyond that side. If all joints of a target are beyond it by twice alpha_3d, every 3D term of eq. 4 is the least one:
the affinity is not positive, and the pair would not be matched. So the result is exactly the same as without pruning.
"""

from typing import no_type_check

import numpy as np

from pipeline.association.tracking.kernels.state import FENCED, LANES
from pipeline.core.runtime.jit import inlined

# Relative margin of the comparisons, far above the rounding errors of affinities.
MARGIN = 1.0 + 1e-7


@inlined
@no_type_check
def _bound_joints(target):
    """Compute the box around a target's predicted joints, as seen from the camera, into ``low_m`` and ``high_m``.

    Each lane keeps a least and a largest value: a single least value would not be vectorised.
    """
    for lane in range(target.low_m.shape[1]):
        low_x, low_y, low_z = np.inf, np.inf, np.inf
        high_x, high_y, high_z = -np.inf, -np.inf, -np.inf
        for start in range(0, target.views.shape[0], LANES):
            k = start + lane
            x, y, z = target.offset_m[0, k], target.offset_m[1, k], target.offset_m[2, k]
            low_x, high_x = x if x < low_x else low_x, x if x > high_x else high_x
            low_y, high_y = y if y < low_y else low_y, y if y > high_y else high_y
            low_z, high_z = z if z < low_z else low_z, z if z > high_z else high_z
        target.low_m[0, lane] = low_x
        target.low_m[1, lane] = low_y
        target.low_m[2, lane] = low_z
        target.high_m[0, lane] = high_x
        target.high_m[1, lane] = high_y
        target.high_m[2, lane] = high_z


@inlined
@no_type_check
def _bound_points(body):
    """Compute the box around a detection's joints in the image into ``low_px`` and ``high_px``, by lane."""
    for lane in range(body.low_px.shape[1]):
        low_u, low_v, high_u, high_v = np.inf, np.inf, -np.inf, -np.inf
        for start in range(0, body.score.shape[0], LANES):
            k = start + lane
            u, v, used = body.points_px[0, k], body.points_px[1, k], body.score[k] > 0
            low_u, high_u = u if used & (u < low_u) else low_u, u if used & (u > high_u) else high_u
            low_v, high_v = v if used & (v < low_v) else low_v, v if used & (v > high_v) else high_v
        body.low_px[0, lane] = low_u
        body.low_px[1, lane] = low_v
        body.high_px[0, lane] = high_u
        body.high_px[1, lane] = high_v


@inlined
@no_type_check
def _least(lanes):
    one, other = min(lanes[0], lanes[1]), min(lanes[2], lanes[3])
    return min(one, other)


@inlined
@no_type_check
def _largest(lanes):
    one, other = max(lanes[0], lanes[1]), max(lanes[2], lanes[3])
    return max(one, other)


@inlined
@no_type_check
def bound_rays(bodies, num_detections, image_from_world, fences):
    """Compute the planes around the rays of each detection of a frame.

    The plane through the camera and a line of the image is a row of eq. 7-9. Its unit normal points away from the rays.
    """
    for number in range(num_detections):
        body, fence, lane = bodies[number], fences[number // FENCED], number % FENCED
        _bound_points(body)
        for axis in range(2):
            fence.border_px[2 * axis, lane] = _largest(body.high_px[axis])
            fence.border_px[2 * axis + 1, lane] = _least(body.low_px[axis])
    p = image_from_world
    for place in range((num_detections + FENCED - 1) // FENCED):
        fence = fences[place]
        for border in range(4):
            axis, sign = border // 2, 1.0 - 2.0 * (border % 2)
            for lane in range(fence.is_far.shape[0]):
                at_px = fence.border_px[border, lane]
                x, y, z = p[axis, 0] - at_px * p[2, 0], p[axis, 1] - at_px * p[2, 1], p[axis, 2] - at_px * p[2, 2]
                over = sign / np.sqrt(x * x + y * y + z * z)
                fence.normal[border, 0, lane] = x * over
                fence.normal[border, 1, lane] = y * over
                fence.normal[border, 2, lane] = z * over


@inlined
@no_type_check
def find_far(target, fences, num_detections, reach_m):
    """Find the detections all of whose rays pass all joints of a target at more than ``reach_m``."""
    _bound_joints(target)
    low_x, low_y, low_z = _least(target.low_m[0]), _least(target.low_m[1]), _least(target.low_m[2])
    high_x, high_y, high_z = _largest(target.high_m[0]), _largest(target.high_m[1]), _largest(target.high_m[2])
    x, y, z = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y), 0.5 * (low_z + high_z)
    half_x, half_y, half_z = 0.5 * (high_x - low_x), 0.5 * (high_y - low_y), 0.5 * (high_z - low_z)
    # Rounding errors of distances grow with the distance from the camera.
    reach_m += (MARGIN - 1.0) * (reach_m + abs(x) + abs(y) + abs(z) + half_x + half_y + half_z)
    for place in range((num_detections + FENCED - 1) // FENCED):
        fence = fences[place]
        for lane in range(fence.is_far.shape[0]):
            is_far = 0.0
            for border in range(4):
                a, b, c = fence.normal[border, 0, lane], fence.normal[border, 1, lane], fence.normal[border, 2, lane]
                apart_m = a * x + b * y + c * z - (abs(a) * half_x + abs(b) * half_y + abs(c) * half_z)
                is_far = 1.0 if apart_m > reach_m else is_far
            fence.is_far[lane] = is_far


@inlined
@no_type_check
def spare_undecided(target, bodies, num_detections, decay_2d, fences):
    """Remove detections from the far ones unless the shared joints' least 3D terms outweigh their largest 2D terms."""
    for j in range(num_detections):
        fence, lane, body, total = fences[j // FENCED], j % FENCED, bodies[j], 0.0
        if fence.is_far[lane] > 0:
            for k in range(body.score.shape[0]):
                known = (body.score[k] > 0) & (target.squared_m2[k] >= 0)
                total += target.decay_3d[k] - MARGIN * decay_2d if known else 0.0
            fence.is_far[lane] = 1.0 if total >= 0 else 0.0
