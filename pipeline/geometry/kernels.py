"""Triangulation of whole tracks as compiled loops.

``triangulation.py`` is the same in plain NumPy; read it first. Tests compare both. Intermediate values are stored in
records whose arrays have the joints last, with a length that is known at compile time, so that loops over joints are
vectorised.
"""

from functools import cache
from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.runtime.jit import kernel, record_dtype, round_up, zero_records

_NUM_NORMAL = 9
_MIN_DETERMINANT = 1e-5


@cache
def view_dtype(lanes: int) -> np.dtype:
    """Record of a camera: rows, weights and distances of all joints."""
    return record_dtype(
        ("rows", np.float64, (8, lanes)),  # planes through the ray (Chen et al. 2020, eq. 7-9)
        ("over2", np.float64, (2, lanes)),  # inverse squared norms of the rows (eq. 11)
        ("normal", np.float64, (_NUM_NORMAL, lanes)),  # contribution to the normal equations at weight 1
        ("base2", np.float64, (lanes,)),  # squared weight
        ("weight", np.float64, (lanes,)),  # squared weight times the robust weight
        ("off2", np.float64, (lanes,)),  # squared distance to the point, 0 where the point or the view is unused
        ("px", np.float64, (2, lanes)),
    )


@cache
def point_dtype(lanes: int) -> np.dtype:
    """Record of the triangulation of all joints from all cameras."""
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


class Workspace(NamedTuple):
    """Workspace of the kernels, which allocate no memory and so need no reference counting."""

    views: np.ndarray  # (cameras,) of view_dtype
    points: np.ndarray  # (1,) of point_dtype
    guess_m: np.ndarray  # (joints, 3)
    before_m: np.ndarray  # (reach + 1, joints, 3): ring buffer of the last unchanged frames
    window: np.ndarray  # (2 * reach + 1,)


def make_workspace(num_cameras: int, num_joints: int, reach: int) -> Workspace:
    """Allocate the workspace of ``triangulate_alone`` and ``settle_disputes``."""
    lanes = round_up(num_joints)
    return Workspace(
        zero_records(num_cameras, view_dtype(lanes)),
        zero_records(1, point_dtype(lanes)),
        np.zeros((num_joints, 3)),
        np.empty((reach + 1, num_joints, 3)),
        np.empty(2 * reach + 1),
    )


@kernel
@no_type_check
def _fill_rows(image_from_world, points_px, weights, min_weight, views):
    """Compute rows of each view and their norms (Chen et al. 2020, eq. 7-9 and 11)."""
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

    The distance d is that of the current point to both planes of a view, to first order the distance to its ray. Its
    square is stored in ``off2``, the number of views farther than ``far_m`` in ``num_far``. Computing the largest
    distance instead would need masked stores, which are slow.
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
    """Minimise ``|| (w o A) X~ ||`` (eq. 10) by Cramer's rule; NaN for fewer than two views or parallel rays."""
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
    """Compute the Geman-McClure cost of the point; infinite where the point is unknown."""
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
def _median_around(xyz_m, frame, joint, axis, reach, workspace):
    """Median of a coordinate over a frame and its neighbours, NaN where the joint is unknown in all of them."""
    count = 0
    for other in range(max(frame - reach, 0), min(frame + reach + 1, xyz_m.shape[0])):
        is_past = other < frame
        value = workspace.before_m[other % (reach + 1), joint, axis] if is_past else xyz_m[other, joint, axis]
        if value == value:
            place = count
            while place > 0 and workspace.window[place - 1] > value:
                workspace.window[place] = workspace.window[place - 1]
                place -= 1
            workspace.window[place] = value
            count += 1
    if count == 0:
        return np.nan
    return 0.5 * (workspace.window[(count - 1) // 2] + workspace.window[count // 2])


@kernel
@no_type_check
def _triangulate_alone(views, point, scales_m, disputed_m):
    """Triangulate a frame by ``triangulation.triangulate_robust`` without a guess.

    ``num_far`` is set to the number of views that were farther than ``disputed_m`` before the last step.
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
    """Decrease the scale step by step; a joint begins with the first scale below its largest distance."""
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
def triangulate_alone(
    image_from_world, points_px, weights, min_weight, scales_m, disputed_m, workspace, xyz_m, disputed
):
    """Triangulate all frames by ``triangulation.triangulate_robust`` without a guess.

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
    workspace
        See ``make_workspace``.
    xyz_m
        Output: world coordinates in metres, (frames, joints, 3), NaN where fewer than two cameras see the point.
    disputed
        Output: whether the views of a joint disagree, (frames, joints).
    """
    views, here = workspace.views, workspace.points[0]
    for frame in range(len(points_px)):
        _fill_rows(image_from_world, points_px[frame], weights[frame], min_weight, views)
        _triangulate_alone(views, here, scales_m, disputed_m)
        for k in range(points_px.shape[2]):
            disputed[frame, k] = here.num_far[k] > 0
            for axis in range(3):
                xyz_m[frame, k, axis] = here.xyz_m[axis, k]


@kernel
@no_type_check
def _neighbours_object(xyz_m, frame, disputed, disputed_m, reach, workspace):
    """Keep a dispute only if the median of neighbouring frames, ``workspace.guess_m``, is far from the joint."""
    any_disputed = False
    for k in range(xyz_m.shape[1]):
        if disputed[k]:
            apart2 = 0.0
            for axis in range(3):
                workspace.guess_m[k, axis] = _median_around(xyz_m, frame, k, axis, reach, workspace)
                apart2 += (workspace.guess_m[k, axis] - xyz_m[frame, k, axis]) ** 2
            disputed[k] = apart2 > disputed_m * disputed_m
            any_disputed |= disputed[k]
    return any_disputed


@kernel
@no_type_check
def _from_guess(views, here, scales_m, disputed, guess_m, xyz_m):
    """Triangulate disputed joints from their guess; keep the position with the lower robust cost."""
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
    image_from_world, points_px, weights, min_weight, scales_m, disputed_m, reach, workspace, xyz_m, disputed
):
    """Triangulate disputed joints again from the median of neighbouring frames; the lower robust cost wins.

    This is ``triangulation.triangulate_robust`` with the running median over ``reach`` frames on each side as guess.

    Parameters
    ----------
    xyz_m, disputed
        Outputs of ``triangulate_alone``, changed in place: positions where the guess wins, and remaining disputes.
    """
    for frame in range(len(points_px)):
        for k in range(xyz_m.shape[1]):
            for axis in range(3):
                workspace.before_m[frame % (reach + 1), k, axis] = xyz_m[frame, k, axis]
        if _neighbours_object(xyz_m, frame, disputed[frame], disputed_m, reach, workspace):
            _fill_rows(image_from_world, points_px[frame], weights[frame], min_weight, workspace.views)
            _from_guess(
                workspace.views, workspace.points[0], scales_m, disputed[frame], workspace.guess_m, xyz_m[frame]
            )
