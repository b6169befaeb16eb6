"""Triangulation and reprojection of whole tracks as compiled loops.

``triangulation.py`` and ``camera.py`` are the same in plain numpy, to read first: tests hold these loops to them. What
is on the way stands in records whose arrays have the joints last and a length known when a loop is compiled, so that a
loop over the joints works on several at a time.
"""

from functools import cache
from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.compiled import kernel, record_dtype, round_up, zero_records
from pipeline.data import Source

_NUM_NORMAL = 9
_MIN_DETERMINANT = 1e-5
_ABSENT, _MEASURED, _INTERPOLATED = int(Source.ABSENT), int(Source.MEASURED), int(Source.INTERPOLATED)


@cache
def view_dtype(lanes: int) -> np.dtype:
    """What a camera says of the joints."""
    return record_dtype(
        ("rows", np.float64, (8, lanes)),  # two planes through the ray (Chen et al. 2020, eq. 7-9)
        ("over2", np.float64, (2, lanes)),  # one over their squared norms (eq. 11)
        ("normal", np.float64, (_NUM_NORMAL, lanes)),  # what they add to the normal equations at weight 1
        ("base2", np.float64, (lanes,)),  # squared weight
        ("weight", np.float64, (lanes,)),  # the same times what the robust loss leaves of it
        ("off2", np.float64, (lanes,)),  # squared distance to the point, 0 where that or the view does not count
        ("px", np.float64, (2, lanes)),
    )


@cache
def point_dtype(lanes: int) -> np.dtype:
    """What all cameras say together."""
    return record_dtype(
        # The six entries of a symmetric 3x3 matrix and the right-hand side of the normal equations.
        ("normal", np.float64, (_NUM_NORMAL, lanes)),
        ("views", np.float64, (lanes,)),
        ("xyz_m", np.float64, (3, lanes)),
        ("kept_m", np.float64, (3, lanes)),
        ("worst2", np.float64, (lanes,)),
        ("num_far", np.float64, (lanes,)),
        ("cost", np.float64, (lanes,)),
        ("kept_cost", np.float64, (lanes,)),
        ("weight_sum", np.float64, (lanes,)),
    )


@cache
def block_dtype(size: int) -> np.dtype:
    """Points to undistort together."""
    return record_dtype(*((name, np.float64, (size,)) for name in ("x", "y", "goal_x", "goal_y")))


class Room(NamedTuple):
    """Arrays to work in: kernels allocate nothing, which spares them the counting of references."""

    views: np.ndarray  # (cameras,) of view_dtype
    points: np.ndarray  # (1,) of point_dtype
    guess_m: np.ndarray  # (joints, 3)
    before_m: np.ndarray  # (reach + 1, joints, 3): the last frames as they were, in turn
    window: np.ndarray  # (2 * reach + 1,)


def make_room(num_cameras: int, num_joints: int, reach: int) -> Room:
    """Room for ``triangulate_alone`` and ``settle_disputes``."""
    lanes = round_up(num_joints)
    return Room(
        zero_records(num_cameras, view_dtype(lanes)),
        zero_records(1, point_dtype(lanes)),
        np.zeros((num_joints, 3)),
        np.empty((reach + 1, num_joints, 3)),
        np.empty(2 * reach + 1),
    )


@kernel
@no_type_check
def _fill_rows(image_from_world, points_px, weights, min_weight, views):
    """Rows of each view and their norms (Chen et al. 2020, eq. 7-9 and 11)."""
    for c in range(len(views)):
        view, p = views[c], image_from_world[c]
        p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
        p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
        p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
        for k in range(weights.shape[1]):
            view.px[0, k], view.px[1, k] = points_px[c, k, 0], points_px[c, k, 1]
            view.weight[k] = weights[c, k]
        for k in range(view.weight.shape[0]):
            u, v, w = view.px[0, k], view.px[1, k], view.weight[k]
            used = (w > 0) & (w >= min_weight) & (u + v == u + v)
            w = w if used else 0.0
            u, v = u if used else 0.0, v if used else 0.0
            a0, a1, a2, a3 = u * p20 - p00, u * p21 - p01, u * p22 - p02, u * p23 - p03
            b0, b1, b2, b3 = v * p20 - p10, v * p21 - p11, v * p22 - p12, v * p23 - p13
            norm_a2, norm_b2 = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
            over = 1.0 / (norm_a2 * norm_b2)
            view.base2[k] = w * w
            view.weight[k] = w * w
            over_a2, over_b2 = over * norm_b2, over * norm_a2
            view.over2[0, k] = over_a2
            view.over2[1, k] = over_b2
            view.rows[0, k] = a0
            view.rows[1, k] = a1
            view.rows[2, k] = a2
            view.rows[3, k] = a3
            view.rows[4, k] = b0
            view.rows[5, k] = b1
            view.rows[6, k] = b2
            view.rows[7, k] = b3
            view.normal[0, k] = over_a2 * a0 * a0 + over_b2 * b0 * b0
            view.normal[1, k] = over_a2 * a0 * a1 + over_b2 * b0 * b1
            view.normal[2, k] = over_a2 * a0 * a2 + over_b2 * b0 * b2
            view.normal[3, k] = over_a2 * a1 * a1 + over_b2 * b1 * b1
            view.normal[4, k] = over_a2 * a1 * a2 + over_b2 * b1 * b2
            view.normal[5, k] = over_a2 * a2 * a2 + over_b2 * b2 * b2
            view.normal[6, k] = -(over_a2 * a0 * a3 + over_b2 * b0 * b3)
            view.normal[7, k] = -(over_a2 * a1 * a3 + over_b2 * b1 * b3)
            view.normal[8, k] = -(over_a2 * a2 * a3 + over_b2 * b2 * b3)


@kernel
@no_type_check
def _reweigh(views, point, scale_m, far_m):
    """Weight views by Geman-McClure, ``(c^2 / (c^2 + d^2))^2``.

    The d is the distance of the point as it is to both planes of a view: to first order that to its ray. Its square
    stays in ``off2``, and in ``num_far`` how many views are farther than ``far_m``: a largest would take masked stores,
    which are slow.
    """
    scale2, far2 = scale_m * scale_m, far_m * far_m
    point.num_far[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(view.base2.shape[0]):
            x, y, z = point.xyz_m[0, k], point.xyz_m[1, k], point.xyz_m[2, k]
            first = view.rows[0, k] * x + view.rows[1, k] * y + view.rows[2, k] * z + view.rows[3, k]
            second = view.rows[4, k] * x + view.rows[5, k] * y + view.rows[6, k] * z + view.rows[7, k]
            squared = first * first * view.over2[0, k] + second * second * view.over2[1, k]
            share = scale2 / (scale2 + squared)
            share = share if squared == squared else 0.0
            off2 = squared if (squared >= 0) & (view.base2[k] > 0) else 0.0
            view.off2[k] = off2
            point.num_far[k] += 1.0 if off2 > far2 else 0.0
            view.weight[k] = view.base2[k] * share * share


@kernel
@no_type_check
def _solve(views, point):
    """Minimise ``|| (w o A) X~ ||`` (eq. 10) by Cramer's rule; NaN where two views are wanting or all rays parallel."""
    point.normal[:] = 0.0
    point.views[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(view.weight.shape[0]):
            weight = view.weight[k]
            point.views[k] += 1.0 if weight > 0 else 0.0
            point.normal[0, k] += weight * view.normal[0, k]
            point.normal[1, k] += weight * view.normal[1, k]
            point.normal[2, k] += weight * view.normal[2, k]
            point.normal[3, k] += weight * view.normal[3, k]
            point.normal[4, k] += weight * view.normal[4, k]
            point.normal[5, k] += weight * view.normal[5, k]
            point.normal[6, k] += weight * view.normal[6, k]
            point.normal[7, k] += weight * view.normal[7, k]
            point.normal[8, k] += weight * view.normal[8, k]
    for k in range(point.views.shape[0]):
        a, b, c, d = point.normal[0, k], point.normal[1, k], point.normal[2, k], point.normal[3, k]
        e, f = point.normal[4, k], point.normal[5, k]
        x, y, z = point.normal[6, k], point.normal[7, k], point.normal[8, k]
        aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
        bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
        determinant = a * aa + b * ab + c * ac
        trace = a + d + f
        solvable = (point.views[k] >= 2) & (determinant > _MIN_DETERMINANT * trace * trace * trace)
        over = 1.0 / determinant
        over = over if solvable else np.nan
        point.xyz_m[0, k] = (aa * x + ab * y + ac * z) * over
        point.xyz_m[1, k] = (ab * x + bb * y + bc * z) * over
        point.xyz_m[2, k] = (ac * x + bc * y + cc * z) * over


@kernel
@no_type_check
def _measure_cost(views, point, scale_m):
    """Geman-McClure cost of the point, infinite where it is not known."""
    scale2 = scale_m * scale_m
    point.cost[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(view.base2.shape[0]):
            x, y, z = point.xyz_m[0, k], point.xyz_m[1, k], point.xyz_m[2, k]
            first = view.rows[0, k] * x + view.rows[1, k] * y + view.rows[2, k] * z + view.rows[3, k]
            second = view.rows[4, k] * x + view.rows[5, k] * y + view.rows[6, k] * z + view.rows[7, k]
            squared = first * first * view.over2[0, k] + second * second * view.over2[1, k]
            cost = view.base2[k] * squared / (squared + scale2)
            point.cost[k] += cost if squared == squared else np.inf


@kernel
@no_type_check
def _median_around(xyz_m, frame, joint, axis, reach, room):
    """Median over a frame and its neighbours on each side, NaN where none of them has the joint."""
    count = 0
    for other in range(max(frame - reach, 0), min(frame + reach + 1, xyz_m.shape[0])):
        is_past = other < frame
        value = room.before_m[other % (reach + 1), joint, axis] if is_past else xyz_m[other, joint, axis]
        if value == value:
            place = count
            while place > 0 and room.window[place - 1] > value:
                room.window[place] = room.window[place - 1]
                place -= 1
            room.window[place] = value
            count += 1
    if count == 0:
        return np.nan
    return 0.5 * (room.window[(count - 1) // 2] + room.window[count // 2])


@kernel
@no_type_check
def _triangulate_alone(views, point, scales_m, disputed_m):
    """``triangulation.triangulate_robust`` without a guess.

    Leaves in ``num_far`` how many views were farther than ``disputed_m`` before the last step.
    """
    _solve(views, point)
    _reweigh(views, point, scales_m[-1], scales_m[-2])
    num_far = 0.0
    for k in range(point.num_far.shape[0]):
        num_far += point.num_far[k]
    if num_far > 0:
        _anneal(views, point, scales_m)
        _reweigh(views, point, scales_m[-1], scales_m[-2])
    _solve(views, point)
    _reweigh(views, point, scales_m[-1], disputed_m)
    _solve(views, point)


@kernel
@no_type_check
def _anneal(views, point, scales_m):
    """Go from scale to scale; a joint begins where the scale is below its worst."""
    worst2 = 0.0
    point.worst2[:] = 0.0
    for k in range(point.worst2.shape[0]):
        for axis in range(3):
            point.kept_m[axis, k] = point.xyz_m[axis, k]
    for c in range(len(views)):
        for k in range(point.worst2.shape[0]):
            point.worst2[k] = max(point.worst2[k], views[c].off2[k])
            worst2 = max(worst2, views[c].off2[k])
    for step in range(len(scales_m) - 1):
        if worst2 <= scales_m[step] * scales_m[step]:
            continue
        _reweigh(views, point, scales_m[step], np.inf)
        _solve(views, point)
        for k in range(point.worst2.shape[0]):
            needed = point.worst2[k] > scales_m[step] * scales_m[step]
            for axis in range(3):
                point.xyz_m[axis, k] = point.xyz_m[axis, k] if needed else point.kept_m[axis, k]
                point.kept_m[axis, k] = point.xyz_m[axis, k]


@kernel
@no_type_check
def triangulate_alone(image_from_world, points_px, weights, min_weight, scales_m, disputed_m, room, xyz_m, disputed):
    """Triangulate every frame robustly: ``triangulation.triangulate_robust`` without a guess.

    Parameters
    ----------
    image_from_world
        Projection matrices to undistorted pixels, (cameras, 3, 4).
    points_px
        Undistorted pixels, (frames, cameras, joints, 2); NaN where unseen.
    weights, min_weight
        Factors of a view's rows, (frames, cameras, joints); 0, or less than ``min_weight``, leaves the view out.
    scales_m, disputed_m
        ``triangulation.SCALES_M`` and ``triangulation.DISPUTED_M``.
    room
        See ``make_room``.
    xyz_m
        Gets the world coordinates in metres, (frames, joints, 3), NaN where fewer than two cameras see the point.
    disputed
        Gets whether the views of a joint disagree, (frames, joints).
    """
    views, here = room.views, room.points[0]
    for frame in range(len(points_px)):
        _fill_rows(image_from_world, points_px[frame], weights[frame], min_weight, views)
        _triangulate_alone(views, here, scales_m, disputed_m)
        for k in range(points_px.shape[2]):
            disputed[frame, k] = here.num_far[k] > 0
            for axis in range(3):
                xyz_m[frame, k, axis] = here.xyz_m[axis, k]


@kernel
@no_type_check
def _neighbours_object(xyz_m, frame, disputed, disputed_m, reach, room):
    """Keep a dispute only where the neighbouring frames see the joint elsewhere, in ``room.guess_m``."""
    any_disputed = False
    for k in range(xyz_m.shape[1]):
        if disputed[k]:
            apart2 = 0.0
            for axis in range(3):
                room.guess_m[k, axis] = _median_around(xyz_m, frame, k, axis, reach, room)
                apart2 += (room.guess_m[k, axis] - xyz_m[frame, k, axis]) ** 2
            disputed[k] = apart2 > disputed_m * disputed_m
            any_disputed |= disputed[k]
    return any_disputed


@kernel
@no_type_check
def _from_guess(views, here, scales_m, disputed, guess_m, xyz_m):
    """Start disputed joints from their guess, and keep what costs less."""
    num_joints = len(xyz_m)
    for k in range(num_joints):
        for axis in range(3):
            here.xyz_m[axis, k] = xyz_m[k, axis]
    _measure_cost(views, here, scales_m[-1])
    for k in range(num_joints):
        here.kept_cost[k] = here.cost[k]
        for axis in range(3):
            here.xyz_m[axis, k] = guess_m[k, axis]
    for step in (-2, -1, -1):
        _reweigh(views, here, scales_m[step], np.inf)
        _solve(views, here)
    _measure_cost(views, here, scales_m[-1])
    for k in range(num_joints):
        if disputed[k] and here.cost[k] < here.kept_cost[k]:
            for axis in range(3):
                xyz_m[k, axis] = here.xyz_m[axis, k]


@kernel
@no_type_check
def settle_disputes(
    image_from_world, points_px, weights, min_weight, scales_m, disputed_m, reach, room, xyz_m, disputed
):
    """Where views disagree, let the neighbouring frames propose a start; the lower robust cost wins.

    ``triangulation.triangulate_robust`` with a guess, the running median over ``reach`` frames on each side.

    Parameters
    ----------
    xyz_m, disputed
        As ``triangulate_alone`` left them; changed, positions where a proposal wins.
    """
    for frame in range(len(points_px)):
        for k in range(xyz_m.shape[1]):
            for axis in range(3):
                room.before_m[frame % (reach + 1), k, axis] = xyz_m[frame, k, axis]
        if _neighbours_object(xyz_m, frame, disputed[frame], disputed_m, reach, room):
            _fill_rows(image_from_world, points_px[frame], weights[frame], min_weight, room.views)
            _from_guess(room.views, room.points[0], scales_m, disputed[frame], room.guess_m, xyz_m[frame])


@kernel
@no_type_check
def _add_errors(here, view, p, m, d):
    """Project the joints into a camera, distortion included, and add what they are off by."""
    p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
    p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
    p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
    m00, m01, m02, m10, m11, m12 = m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]
    s1, s2, s3, s4 = d[8], d[9], d[10], d[11]
    for k in range(view.weight.shape[0]):
        x, y, z = here.xyz_m[0, k], here.xyz_m[1, k], here.xyz_m[2, k]
        depth = p20 * x + p21 * y + p22 * z + p23
        over = 1.0 / depth
        over = over if depth > 1e-6 else np.nan
        u, v = (p00 * x + p01 * y + p02 * z + p03) * over, (p10 * x + p11 * y + p12 * z + p13) * over
        r2 = u * u + v * v
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        seen_u = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + r2 * (s1 + s2 * r2)
        seen_v = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v + r2 * (s3 + s4 * r2)
        dx = m00 * seen_u + m01 * seen_v + m02 - view.px[0, k]
        dy = m10 * seen_u + m11 * seen_v + m12 - view.px[1, k]
        off_px = np.sqrt(dx * dx + dy * dy)
        here.cost[k] += off_px if view.weight[k] > 0 else 0.0
        here.weight_sum[k] += view.weight[k]
        here.views[k] += 1.0 if view.weight[k] > 0 else 0.0


@kernel
@no_type_check
def reprojection_errors(
    poses,
    matrices,
    distortions,
    xyz_m,
    points_px,
    weights,
    min_weight,
    points,
    views_room,
    error_px,
    mean_weight,
    views,
):
    """Mean reprojection error over the cameras that saw a joint, and how many those are.

    Parameters
    ----------
    poses
        Extrinsics [R | t], (cameras, 3, 4).
    matrices
        Camera matrices, (cameras, 3, 3).
    distortions
        Twelve coefficients a camera, as ``camera.distort`` takes them.
    xyz_m
        World coordinates, (frames, joints, 3).
    points_px
        Pixels as seen, (frames, cameras, joints, 2).
    weights, min_weight
        Above 0 and no less than ``min_weight`` where an observation was used, (frames, cameras, joints).
    points, views_room
        Room to work in, zeros (1,) of ``point_dtype`` and of ``view_dtype``.
    error_px
        Gets the error, (frames, joints), NaN where no camera saw the joint or it is not known.
    mean_weight, views
        Get the mean weight of the cameras that saw the joint, and how many they are, (frames, joints); 0 where there
        is no error.
    """
    here, view = points[0], views_room[0]
    for frame in range(len(weights)):
        here.cost[:] = 0.0
        here.views[:] = 0.0
        here.weight_sum[:] = 0.0
        for k in range(weights.shape[2]):
            for axis in range(3):
                here.xyz_m[axis, k] = xyz_m[frame, k, axis]
        for c in range(weights.shape[1]):
            for k in range(weights.shape[2]):
                view.px[0, k], view.px[1, k] = points_px[frame, c, k, 0], points_px[frame, c, k, 1]
                view.weight[k] = weights[frame, c, k] if weights[frame, c, k] >= min_weight else 0.0
            _add_errors(here, view, poses[c], matrices[c], distortions[c])
        for k in range(weights.shape[2]):
            seen = here.views[k]
            error, weight = here.cost[k] / seen, here.weight_sum[k] / seen
            located = (seen > 0) & (error == error)
            views[frame, k] = seen if located else 0.0
            error_px[frame, k] = error if located else np.nan
            mean_weight[frame, k] = weight if located else 0.0


@kernel
@no_type_check
def fill_gaps(xyz_m, max_gap, last_known, source):
    """Interpolate linearly, in place, over gaps of at most ``max_gap`` frames between two known positions.

    Parameters
    ----------
    xyz_m
        World coordinates, (frames, joints, 3), NaN where a joint is not known; changed.
    last_known
        Room to work in, (joints,) of -1.
    source
        Gets how each joint is known, (frames, joints) of ``data.Source``.
    """
    for frame in range(xyz_m.shape[0]):
        for k in range(xyz_m.shape[1]):
            if xyz_m[frame, k, 0] != xyz_m[frame, k, 0]:
                source[frame, k] = _ABSENT
                continue
            source[frame, k] = _MEASURED
            left = last_known[k]
            if left >= 0 and 1 < frame - left <= max_gap + 1:
                for missed in range(left + 1, frame):
                    share = (missed - left) / (frame - left)
                    source[missed, k] = _INTERPOLATED
                    for axis in range(3):
                        xyz_m[missed, k, axis] = (1 - share) * xyz_m[left, k, axis] + share * xyz_m[frame, k, axis]
            last_known[k] = frame


@kernel
@no_type_check
def undistort(points, d, num_steps, tolerance, blocks):
    """Invert ``camera.distort`` in place by Newton's method with the exact Jacobian; (points, 2), NaN stays NaN.

    Points go in blocks that end together; ``blocks`` is room for one, (1,) of ``block_dtype``.
    """
    block = blocks[0]
    size = block.x.shape[0]
    k1, k2, p1, p2, k3, k4, k5, k6 = d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]
    s1, s2, s3, s4 = d[8], d[9], d[10], d[11]
    for start in range(0, len(points), size):
        stop = min(start + size, len(points))
        for i in range(stop - start):
            block.goal_x[i], block.goal_y[i] = points[start + i, 0], points[start + i, 1]
            block.x[i], block.y[i] = points[start + i, 0], points[start + i, 1]
        for _ in range(num_steps):
            num_open = 0.0
            for i in range(size):
                u, v = block.x[i], block.y[i]
                r2 = u * u + v * v
                over = 1.0 / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
                radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) * over
                # Twice the derivative of radial by r2: quotient rule.
                slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) * over
                off_u = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u) + r2 * (s1 + s2 * r2) - block.goal_x[i]
                off_v = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v + r2 * (s3 + s4 * r2) - block.goal_y[i]
                prism_u, prism_v = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
                uu = radial + u * u * slope + 2 * p1 * v + 6 * p2 * u + prism_u * u
                uv = u * v * slope + 2 * p1 * u + 2 * p2 * v + prism_u * v
                vu = u * v * slope + 2 * p1 * u + 2 * p2 * v + prism_v * u
                vv = radial + v * v * slope + 6 * p1 * v + 2 * p2 * u + prism_v * v
                determinant = uu * vv - uv * vu
                over = 1.0 / determinant
                # Where the model folds over, beyond the image, the Jacobian loses its sign: stay there rather than
                # diverge.
                over = over if determinant > 1e-3 else 0.0
                block.x[i] = u - (vv * off_u - uv * off_v) * over
                block.y[i] = v - (uu * off_v - vu * off_u) * over
                num_open += 1.0 if (off_u * off_u + off_v * off_v) * over > tolerance * tolerance else 0.0
            if num_open == 0:
                break
        for i in range(stop - start):
            points[start + i, 0], points[start + i, 1] = block.x[i], block.y[i]
