"""Compiled loops of cross-view tracking over frames (Chen et al. 2020, algorithm 1).

``tests/pipeline/association/tracking/reference.py`` is the same method in plain NumPy, to be read first; tests compare
the two. ``state`` describes the arrays.
"""

from typing import no_type_check

import numpy as np

from pipeline.association.tracking.kernels.assignment_kernels import assign
from pipeline.association.tracking.kernels.ending_kernels import bury, merge_duplicates
from pipeline.association.tracking.kernels.pruning_kernels import MARGIN, bound_rays, find_far, spare_undecided
from pipeline.association.tracking.kernels.state import FENCED, MIN_JOINTS, NUM_NORMAL, NUM_RECENT
from pipeline.core.runtime.jit import inlined, kernel, prefetch_row

_MIN_DETERMINANT = 1e-5


@kernel
@no_type_check
def clear(targets, slot, target_id):
    """Reset a slot to a target without observations."""
    target = targets.state[slot]
    target.target_id = target_id
    target.xyz_m[:] = np.nan
    target.updated_s[:] = -np.inf
    target.velocity_m_s[:] = 0.0
    target.normal_sum[:] = 0.0
    target.views[:] = 0.0
    target.sum_s = -np.inf
    target.oldest_s = np.inf
    target.num_recent = 0
    target.is_fitted = True
    target.moved_s = -np.inf
    target.supported_s = -np.inf
    target.num_supported = 0
    target.confirmed = False
    targets.matched_s[slot] = -np.inf
    targets.counted[slot] = False
    for camera in range(targets.views.shape[1]):
        targets.views[slot, camera].last_px[:] = np.nan


@inlined
@no_type_check
def _drop_old_views(targets, slot, time_s, limits):
    """Subtract views that are too old from the normal equations; set the equations of a joint without views to zero."""
    target = targets.state[slot]
    if time_s - target.oldest_s < limits.velocity_window_s:
        return
    target.oldest_s = np.inf
    for camera in range(targets.matched_s.shape[1]):
        if not targets.counted[slot, camera]:
            continue
        if time_s - targets.matched_s[slot, camera] < limits.velocity_window_s:
            target.oldest_s = min(target.oldest_s, targets.matched_s[slot, camera])
            continue
        targets.counted[slot, camera] = False
        view = targets.views[slot, camera]
        weight = np.exp(-2 * limits.lambda_t_hz * (target.sum_s - targets.matched_s[slot, camera]))
        for k in range(target.views.shape[0]):
            target.views[k] -= 1.0 if view.normal[0, k] + view.normal[3, k] + view.normal[5, k] > 0 else 0.0
        for entry in range(NUM_NORMAL):
            for k in range(target.views.shape[0]):
                total = target.normal_sum[entry, k] - weight * view.normal[entry, k]
                target.normal_sum[entry, k] = total if target.views[k] > 0 else 0.0


@inlined
@no_type_check
def observe(targets, slot, camera, time_s, body_number, image_from_world, limits):
    """Store a matched detection as the last match of its camera (eq. 6-9 and the norm of eq. 11).

    The rows are weighted with the detector's confidence and with ``a^2 / (a^2 + d^2)``, where d is the distance of the
    ray to the expected joint and a is alpha_3d. In the sum of the normal equations the detection replaces the camera's
    previous match; the other cameras' matches decay by ``exp(-lambda_t (t - t_i))`` squared.
    """
    _drop_old_views(targets, slot, time_s, limits)
    target, view, body = targets.state[slot], targets.views[slot, camera], targets.bodies[body_number]
    rate_hz = 2 * limits.lambda_t_hz
    decay = np.exp(-rate_hz * (time_s - target.sum_s)) if time_s > target.sum_s else 1.0
    had = 1.0 if targets.counted[slot, camera] else 0.0
    old = np.exp(-rate_hz * (time_s - targets.matched_s[slot, camera])) if targets.counted[slot, camera] else 0.0
    p = image_from_world[camera]
    p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
    p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
    p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
    scale2 = limits.alpha_3d_m * limits.alpha_3d_m
    for k in range(body.score.shape[0]):
        u, v = body.points_px[0, k], body.points_px[1, k]
        view.last_px[0, k] = u if body.score[k] > 0 else np.nan
        view.last_px[1, k] = v if body.score[k] > 0 else np.nan
        a0, a1, a2, a3 = u * p20 - p00, u * p21 - p01, u * p22 - p02, u * p23 - p03
        b0, b1, b2, b3 = v * p20 - p10, v * p21 - p11, v * p22 - p12, v * p23 - p13
        norm_a2, norm_b2 = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
        over = 1.0 / (norm_a2 * norm_b2)
        over_a2, over_b2 = norm_b2 * over, norm_a2 * over
        x, y, z = target.expected_m[0, k], target.expected_m[1, k], target.expected_m[2, k]
        first, second = a0 * x + a1 * y + a2 * z + a3, b0 * x + b1 * y + b2 * z + b3
        distance2 = first * first * over_a2 + second * second * over_b2
        doubt = scale2 / (scale2 + distance2)
        weight = body.score[k] * body.score[k] * (doubt if distance2 >= 0 else 1.0)  # NaN: nothing was expected
        weight_a, weight_b = weight * over_a2, weight * over_b2
        n0, o0 = weight_a * a0 * a0 + weight_b * b0 * b0, view.normal[0, k]
        n1, o1 = weight_a * a0 * a1 + weight_b * b0 * b1, view.normal[1, k]
        n2, o2 = weight_a * a0 * a2 + weight_b * b0 * b2, view.normal[2, k]
        n3, o3 = weight_a * a1 * a1 + weight_b * b1 * b1, view.normal[3, k]
        n4, o4 = weight_a * a1 * a2 + weight_b * b1 * b2, view.normal[4, k]
        n5, o5 = weight_a * a2 * a2 + weight_b * b2 * b2, view.normal[5, k]
        n6, o6 = -(weight_a * a0 * a3 + weight_b * b0 * b3), view.normal[6, k]
        n7, o7 = -(weight_a * a1 * a3 + weight_b * b1 * b3), view.normal[7, k]
        n8, o8 = -(weight_a * a2 * a3 + weight_b * b2 * b3), view.normal[8, k]
        others = target.views[k] - (had if o0 + o3 + o5 > 0 else 0.0)
        # Exactly zero where no other camera sees the joint: the remainder of the sum is rounding error.
        keep = decay if others > 0 else 0.0
        gone = old if others > 0 else 0.0
        target.views[k] = others + (1.0 if weight > 0 else 0.0)
        target.normal_sum[0, k] = keep * target.normal_sum[0, k] - gone * o0 + n0
        target.normal_sum[1, k] = keep * target.normal_sum[1, k] - gone * o1 + n1
        target.normal_sum[2, k] = keep * target.normal_sum[2, k] - gone * o2 + n2
        target.normal_sum[3, k] = keep * target.normal_sum[3, k] - gone * o3 + n3
        target.normal_sum[4, k] = keep * target.normal_sum[4, k] - gone * o4 + n4
        target.normal_sum[5, k] = keep * target.normal_sum[5, k] - gone * o5 + n5
        target.normal_sum[6, k] = keep * target.normal_sum[6, k] - gone * o6 + n6
        target.normal_sum[7, k] = keep * target.normal_sum[7, k] - gone * o7 + n7
        target.normal_sum[8, k] = keep * target.normal_sum[8, k] - gone * o8 + n8
        view.normal[0, k] = n0
        view.normal[1, k] = n1
        view.normal[2, k] = n2
        view.normal[3, k] = n3
        view.normal[4, k] = n4
        view.normal[5, k] = n5
        view.normal[6, k] = n6
        view.normal[7, k] = n7
        view.normal[8, k] = n8
    target.sum_s = time_s
    target.oldest_s = min(target.oldest_s, time_s)
    targets.matched_s[slot, camera] = time_s
    targets.counted[slot, camera] = True


@inlined
@no_type_check
def move(targets, slot, time_s, limits, earned):
    """Triangulate incrementally from the last match of every camera (eq. 10-11)."""
    target = targets.state[slot]
    newest = _newest_place(target, time_s, limits)
    num_found = 0.0
    for k in range(target.views.shape[0]):
        a, b, c = target.normal_sum[0, k], target.normal_sum[1, k], target.normal_sum[2, k]
        d, e, f = target.normal_sum[3, k], target.normal_sum[4, k], target.normal_sum[5, k]
        x, y, z = target.normal_sum[6, k], target.normal_sum[7, k], target.normal_sum[8, k]
        aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
        bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * aa + b * ab + c * ac
        trace = a + d + f
        solvable = (target.views[k] >= 2) & (determinant > _MIN_DETERMINANT * trace * trace * trace)
        over = 1.0 / determinant
        # Read for every joint: reading only unsolvable joints would need masked stores below, which are slow.
        before_x, before_y, before_z = target.xyz_m[0, k], target.xyz_m[1, k], target.xyz_m[2, k]
        before_s = target.updated_s[k]
        x_m, y_m, z_m = (
            (aa * x + ab * y + ac * z) * over,
            (ab * x + bb * y + bc * z) * over,
            (ac * x + bc * y + cc * z) * over,
        )
        target.recent_m[newest, 0, k] = x_m if solvable else np.nan
        target.recent_m[newest, 1, k] = y_m if solvable else np.nan
        target.recent_m[newest, 2, k] = z_m if solvable else np.nan
        target.xyz_m[0, k] = x_m if solvable else before_x
        target.xyz_m[1, k] = y_m if solvable else before_y
        target.xyz_m[2, k] = z_m if solvable else before_z
        target.updated_s[k] = time_s if solvable else before_s
        num_found += 1.0 if solvable else 0.0
    if num_found > 0:
        target.moved_s = time_s
    target.is_fitted = False
    if time_s > target.supported_s:
        num_views = 0
        for camera in range(targets.matched_s.shape[1]):
            if time_s - targets.matched_s[slot, camera] < limits.instant_s:
                num_views += 1
        if num_views >= 2:
            target.supported_s = time_s
            target.num_supported += 1
            if target.num_supported >= limits.confirm_instants:
                target.confirmed = True
                earned[target.target_id] = True


@inlined
@no_type_check
def _newest_place(target, time_s, limits):
    """Index for the current position among the recent positions; it replaces the newest entry if that is recent."""
    spacing_s = limits.velocity_window_s / (NUM_RECENT - 1)
    if target.num_recent == 0 or time_s - target.recent_since_s >= spacing_s:
        target.recent_since_s = time_s
        target.num_recent += 1
    newest = (target.num_recent - 1) % NUM_RECENT
    target.recent_s[newest] = time_s
    return newest


@inlined
@no_type_check
def _fit_velocity(target, sums, window_s):
    """Fit velocities to the recent positions by linear least squares (eq. 5), 0 with fewer than three positions."""
    newest_s = target.recent_s[(target.num_recent - 1) % NUM_RECENT]
    sums.fit[:] = 0.0
    for place in range(min(target.num_recent, NUM_RECENT)):
        since_s = target.recent_s[place] - newest_s
        if since_s < -window_s:
            continue
        for k in range(target.views.shape[0]):
            x, y, z = target.recent_m[place, 0, k], target.recent_m[place, 1, k], target.recent_m[place, 2, k]
            known = x == x
            x, y, z = x if known else 0.0, y if known else 0.0, z if known else 0.0
            count = 1.0 if known else 0.0
            sums.fit[0, k] += count
            sums.fit[1, k] += count * since_s
            sums.fit[2, k] += count * since_s * since_s
            sums.fit[3, k] += x
            sums.fit[4, k] += y
            sums.fit[5, k] += z
            sums.fit[6, k] += since_s * x
            sums.fit[7, k] += since_s * y
            sums.fit[8, k] += since_s * z
    for k in range(target.views.shape[0]):
        count, s1 = sums.fit[0, k], sums.fit[1, k]
        spread = count * sums.fit[2, k] - s1 * s1
        over = 1.0 / spread
        over = over if (count >= 3) & (spread > 0) else 0.0
        target.velocity_m_s[0, k] = (count * sums.fit[6, k] - s1 * sums.fit[3, k]) * over
        target.velocity_m_s[1, k] = (count * sums.fit[7, k] - s1 * sums.fit[4, k]) * over
        target.velocity_m_s[2, k] = (count * sums.fit[8, k] - s1 * sums.fit[5, k]) * over
    target.is_fitted = True


@inlined
@no_type_check
def _expect(target, sums, time_s, center_m, limits):
    """Predict joints by linear motion (eq. 5), and their offsets, distances and decay for eq. 4 in a camera.

    Returns the least ``decay_3d`` of a located joint.
    """
    if not target.is_fitted and time_s > target.moved_s:
        _fit_velocity(target, sums, limits.velocity_window_s)
    center_x, center_y, center_z = center_m[0], center_m[1], center_m[2]
    for k in range(target.views.shape[0]):
        ahead_s = min(time_s - target.updated_s[k], limits.max_extrapolation_s)
        x_m = target.xyz_m[0, k] + ahead_s * target.velocity_m_s[0, k]
        y_m = target.xyz_m[1, k] + ahead_s * target.velocity_m_s[1, k]
        z_m = target.xyz_m[2, k] + ahead_s * target.velocity_m_s[2, k]
        target.expected_m[0, k] = x_m
        target.expected_m[1, k] = y_m
        target.expected_m[2, k] = z_m
        x_m, y_m, z_m = x_m - center_x, y_m - center_y, z_m - center_z
        target.offset_m[0, k] = x_m
        target.offset_m[1, k] = y_m
        target.offset_m[2, k] = z_m
        target.squared_m2[k] = x_m * x_m + y_m * y_m + z_m * z_m
    known_s, decay, least = np.nan, 0.0, np.inf
    for k in range(target.views.shape[0]):
        if target.updated_s[k] != known_s:  # most joints were updated together
            known_s = target.updated_s[k]
            decay = limits.weight_3d * np.exp(-limits.lambda_a_hz * (time_s - known_s))
            least = min(least, decay) if known_s > -np.inf else least
        target.decay_3d[k] = decay
    return least


@inlined
@no_type_check
def _affinity(target, view, body, scale_2d, decay_2d, over_alpha_3d):
    """Affinity A of a target and a detection (eq. 1, 2 and 4); -inf where they share too few joints."""
    total, count = 0.0, 0.0
    for k in range(body.score.shape[0]):
        along_m = (
            target.offset_m[0, k] * body.rays[0, k]
            + target.offset_m[1, k] * body.rays[1, k]
            + target.offset_m[2, k] * body.rays[2, k]
        )
        across2 = target.squared_m2[k] - along_m * along_m
        across_m = np.sqrt(across2 if across2 > 0 else 0.0)
        term_3d = 1.0 - across_m * over_alpha_3d
        term_3d = term_3d if (term_3d > -1.0) & (along_m >= 0) else -1.0
        dx, dy = body.points_px[0, k] - view.last_px[0, k], body.points_px[1, k] - view.last_px[1, k]
        moved2 = dx * dx + dy * dy
        term_2d = 1.0 - np.sqrt(moved2) * scale_2d
        term_2d = term_2d if term_2d > -1.0 else -1.0
        term_2d = term_2d if moved2 >= 0 else 0.0
        known = (body.score[k] > 0) & (target.squared_m2[k] >= 0)
        total += target.decay_3d[k] * term_3d + decay_2d * term_2d if known else 0.0
        count += 1.0 if known else 0.0
    return total / count if count >= MIN_JOINTS else -np.inf


@kernel
@no_type_check
def epipolar_affinity(fundamental, left_px, left_score, right_px, right_score, alpha_px):
    """Affinity A_e of detections in two cameras (eq. 12-13), -inf where they share too few joints."""
    total, count = 0.0, 0
    for k in range(left_score.shape[0]):
        if left_score[k] > 0 and right_score[k] > 0:
            x, y, u, v = left_px[k, 0], left_px[k, 1], right_px[k, 0], right_px[k, 1]
            f = fundamental
            # The epipolar line in the left image, and the slope of the epipolar line in the right image.
            a, b = f[0, 0] * u + f[0, 1] * v + f[0, 2], f[1, 0] * u + f[1, 1] * v + f[1, 2]
            c = f[2, 0] * u + f[2, 1] * v + f[2, 2]
            d, e = f[0, 0] * x + f[1, 0] * y + f[2, 0], f[0, 1] * x + f[1, 1] * y + f[2, 1]
            across = abs(a * x + b * y + c)
            distance_px = 0.5 * across * (1.0 / np.sqrt(a * a + b * b) + 1.0 / np.sqrt(d * d + e * e))
            total += max(1.0 - distance_px / alpha_px, -1.0)
            count += 1
    return total / count if count >= MIN_JOINTS else -np.inf


@inlined
@no_type_check
def _may_start_somebody(frames, rig, limits, pool, camera, time_s):
    """True if an unmatched detection of this camera has a positive affinity with a recent one of another camera."""
    for other in range(len(pool.num_rows)):
        if other == camera or time_s - pool.time_s[other] >= limits.instant_s:
            continue
        for i in range(pool.num_rows[camera]):
            row = pool.rows[camera, i]
            for j in range(pool.num_rows[other]):
                twin = pool.rows[other, j]
                affinity = epipolar_affinity(
                    rig.fundamental[camera, other],
                    frames.points_px[row],
                    frames.score[row],
                    frames.points_px[twin],
                    frames.score[twin],
                    limits.alpha_epipolar_px,
                )
                if affinity > 0:
                    return True
    return False


@inlined
@no_type_check
def prepare(targets, frames, first, num_detections, world_ray_from_image):
    """Copy the detections of a frame to ``targets.bodies``, and compute their viewing rays (eq. 3)."""
    m = world_ray_from_image
    for number in range(num_detections):
        body = targets.bodies[number]
        for k in range(frames.score.shape[1]):
            u, v = frames.flat_px[first + number, 2 * k], frames.flat_px[first + number, 2 * k + 1]
            score = frames.score[first + number, k]
            # A joint that is not used must not add NaN to sums.
            body.points_px[0, k] = u if score > 0 else 0.0
            body.points_px[1, k] = v if score > 0 else 0.0
            body.score[k] = score
        for k in range(body.score.shape[0]):
            u, v = body.points_px[0, k], body.points_px[1, k]
            x, y = m[0, 0] * u + m[0, 1] * v + m[0, 2], m[1, 0] * u + m[1, 1] * v + m[1, 2]
            z = m[2, 0] * u + m[2, 1] * v + m[2, 2]
            over = 1.0 / np.sqrt(x * x + y * y + z * z)
            body.rays[0, k] = x * over
            body.rays[1, k] = y * over
            body.rays[2, k] = z * over


@inlined
@no_type_check
def find_pairs(targets, camera, time_s, num_detections, rig, limits, room):
    """Predict the targets and list the pairs of target and detection that may have a positive affinity.

    Returns the number of pairs in ``room.pair_target`` and ``room.pair_detection``.
    """
    gap_s, decay_2d, scale_2d, num_pairs = np.nan, 0.0, 0.0, 0
    bound_rays(targets.bodies, num_detections, rig.image_from_world[camera], room.fences)
    for i in range(targets.alive[0]):
        slot = targets.order[i]
        target = targets.state[slot]
        least_3d = _expect(target, targets.sums[0], time_s, rig.center_m[camera], limits)
        if time_s - targets.matched_s[slot, camera] != gap_s:  # most targets were matched together
            gap_s = time_s - targets.matched_s[slot, camera]
            decay_2d = limits.weight_2d * np.exp(-limits.lambda_a_hz * gap_s)
            scale_2d = 1.0 / (limits.alpha_2d_px_s * gap_s)
        room.decay_2d[i], room.scale_2d[i] = decay_2d, scale_2d
        find_far(target, room.fences, num_detections, 2 * limits.alpha_3d_m)
        if not least_3d > MARGIN * decay_2d:
            spare_undecided(target, targets.bodies, num_detections, decay_2d, room.fences)
        for j in range(num_detections):
            # Without a branch, which could not be predicted: the next pair replaces a pair that is not counted.
            room.pair_target[num_pairs], room.pair_detection[num_pairs] = i, j
            num_pairs += 1 if room.fences[j // FENCED].is_far[j % FENCED] == 0 else 0
    return num_pairs


@inlined
@no_type_check
def _choose(targets, num_detections, room):
    """Match targets to detections, confirmed targets before tentative ones."""
    count = targets.alive[0]
    for chooses in (True, False):
        num_rows, num_columns = 0, 0
        for i in range(count):
            if targets.state[targets.order[i]].confirmed == chooses:
                room.rows[num_rows] = i
                num_rows += 1
        for j in range(num_detections):
            if room.free[j]:
                room.columns[num_columns] = j
                num_columns += 1
        if num_rows > 0 and num_columns > 0:
            assign(num_rows, num_columns, room)
        for i in range(num_rows):
            if room.match[room.rows[i]] >= 0:
                room.free[room.match[room.rows[i]]] = False


@inlined
@no_type_check
def _match(targets, camera, num_detections, num_pairs, limits, room):
    """Match targets to detections into ``room.match`` and ``room.free``; only the listed pairs are considered.

    If every target and every detection is in at most one positive pair, the positive pairs are the solution.
    """
    count, over_alpha_3d, num_positive = targets.alive[0], 1.0 / limits.alpha_3d_m, 0
    room.match[:count] = -1
    room.wanted[:num_detections] = 0
    for pair in range(num_pairs):
        i, j = room.pair_target[pair], room.pair_detection[pair]
        slot = targets.order[i]
        target, view, body = targets.state[slot], targets.views[slot, camera], targets.bodies[j]
        affinity = _affinity(target, view, body, room.scale_2d[i], room.decay_2d[i], over_alpha_3d)
        room.pair_affinity[pair] = affinity
        is_positive = 1 if affinity > 0 else 0
        room.match[i] = j if is_positive else room.match[i]
        room.wanted[j] += is_positive
        num_positive += is_positive
    num_matched, num_wanted = 0, 0
    for i in range(count):
        num_matched += 1 if room.match[i] >= 0 else 0
    for j in range(num_detections):
        room.free[j] = room.wanted[j] == 0
        num_wanted += 1 if room.wanted[j] > 0 else 0
    if num_matched != num_positive or num_wanted != num_positive:
        room.match[:count] = -1
        room.free[:num_detections] = True
        room.affinity[:count, :num_detections] = -1.0
        for pair in range(num_pairs):
            room.affinity[room.pair_target[pair], room.pair_detection[pair]] = room.pair_affinity[pair]
        _choose(targets, num_detections, room)


@kernel
@no_type_check
def track(start, frames, rig, limits, targets, pool, outcome, room):
    """Match frames to targets from frame ``start`` on.

    Returns the number of the first frame after which detections in the pool may start a target; the number of frames if
    none.
    """
    match, free = room.match, room.free
    for event in range(start, len(frames.time_s)):
        time_s, camera = frames.time_s[event], frames.camera[event]
        first, num_detections = frames.first[event], frames.last[event] - frames.first[event]
        upcoming = min(event + 1, len(frames.time_s) - 1)
        for row in range(frames.first[upcoming], frames.last[upcoming]):
            prefetch_row(frames.flat_px, row)
            prefetch_row(frames.score, row)
        if time_s > outcome.merged_s[0]:
            merge_duplicates(targets, time_s, limits, outcome.replaced_by, room)
            outcome.merged_s[0] = time_s
            bury(targets, time_s, limits)
        count = targets.alive[0]
        free[:num_detections] = True
        if count > 0 and num_detections > 0:
            prepare(targets, frames, first, num_detections, rig.world_ray_from_image[camera])
            num_pairs = find_pairs(targets, camera, time_s, num_detections, rig, limits, room)
            _match(targets, camera, num_detections, num_pairs, limits, room)
            for i in range(count):
                if match[i] >= 0:
                    slot = targets.order[i]
                    outcome.identity[first + match[i]] = targets.state[slot].target_id
                    observe(targets, slot, camera, time_s, match[i], rig.image_from_world, limits)
                    move(targets, slot, time_s, limits, outcome.earned)

        unmatched = 0
        for j in range(num_detections):
            if free[j]:
                pool.rows[camera, unmatched] = first + j
                unmatched += 1
        pool.num_rows[camera] = unmatched
        pool.time_s[camera] = time_s
        if unmatched > 0 and _may_start_somebody(frames, rig, limits, pool, camera, time_s):
            return event
    return len(frames.time_s)
