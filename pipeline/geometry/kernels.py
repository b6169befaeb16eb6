"""Triangulation of whole tracks, and interpolation of their gaps, as compiled loops.

``triangulation.py`` is the triangulation in plain NumPy; read it first. Tests compare both. Joints are computed in
blocks. Intermediate values of a block are stored in records whose arrays have its joints last, with a length that is
known at compile time, so that loops over joints are vectorised and compiled once for all numbers of joints. A loop
takes as many vectors as the joints fill: a body without feet fills five of the seven of a block.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.core.data.people import Source
from pipeline.core.runtime.jit import kernel, record_dtype, zero_records
from pipeline.geometry.triangulation import DISPUTED_M, SCALES_M

BLOCK_JOINTS = 28
"""Joints that are computed together, a multiple of ``VECTOR_JOINTS``; a body with feet is one block."""

VECTOR_JOINTS = 4
"""Joints of a vector; the compiler knows that no joints remain behind the vectors."""

_NUM_NORMAL = 9
# The guess for a joint is its median over so many frames on each side.
_REACH = 2
_MIN_DETERMINANT = 1e-5
_ABSENT, _MEASURED, _INTERPOLATED = int(Source.ABSENT), int(Source.MEASURED), int(Source.INTERPOLATED)

VIEW_DTYPE = record_dtype(
    ("rows", np.float64, (8, BLOCK_JOINTS)),  # planes through the ray (Chen et al. 2020, eq. 7-9)
    ("over2", np.float64, (2, BLOCK_JOINTS)),  # inverse squared norms of the rows (eq. 11)
    ("normal", np.float64, (_NUM_NORMAL, BLOCK_JOINTS)),  # contribution to the normal equations at weight 1
    ("base2", np.float64, (BLOCK_JOINTS,)),  # squared weight
    ("weight", np.float64, (BLOCK_JOINTS,)),  # squared weight times the robust weight
    ("off2", np.float64, (BLOCK_JOINTS,)),  # squared distance to the point, 0 where the point or the view is unused
    ("px", np.float64, (2, BLOCK_JOINTS)),
)
"""Record of a camera: rows, weights and distances of a block of joints."""

POINT_DTYPE = record_dtype(
    # The six entries of a symmetric 3x3 matrix and the right-hand side of the normal equations.
    ("normal", np.float64, (_NUM_NORMAL, BLOCK_JOINTS)),
    ("views", np.float64, (BLOCK_JOINTS,)),
    ("xyz_m", np.float64, (3, BLOCK_JOINTS)),
    ("kept_m", np.float64, (3, BLOCK_JOINTS)),
    ("worst2", np.float64, (BLOCK_JOINTS,)),
    ("num_far", np.float64, (BLOCK_JOINTS,)),
    ("cost", np.float64, (BLOCK_JOINTS,)),
    ("kept_cost", np.float64, (BLOCK_JOINTS,)),
    ("weight_sum", np.float64, (BLOCK_JOINTS,)),
    ("num_vectors", np.int64),  # vectors that have joints
)
"""Record of the triangulation of a block of joints from all cameras."""


class Solver(NamedTuple):
    """Cameras and settings of a triangulation, and workspace: kernels allocate no memory."""

    image_from_world: np.ndarray  # (cameras, 3, 4), to undistorted pixels
    min_weight: float  # a view with a smaller weight, or with weight 0, is left out
    scales_m: np.ndarray  # triangulation.SCALES_M
    disputed_m: float  # triangulation.DISPUTED_M
    reach: int  # a guess is the median over so many frames on each side
    views: np.ndarray  # (cameras,) of VIEW_DTYPE
    points: np.ndarray  # (1,) of POINT_DTYPE
    window: np.ndarray  # (2 * reach + 1,): sorted values around a frame


def make_solver(image_from_world: np.ndarray, min_weight: float) -> Solver:
    """Allocate the workspace, and gather the settings of ``triangulation.triangulate_robust``."""
    return Solver(
        image_from_world,
        float(min_weight),
        np.array(SCALES_M),
        DISPUTED_M,
        _REACH,
        zero_records(len(image_from_world), VIEW_DTYPE),
        zero_records(1, POINT_DTYPE),
        np.empty(2 * _REACH + 1),
    )


@kernel
@no_type_check
def count_vectors(num_joints):
    """Count the vectors that joints of a block fill, the last one perhaps in part."""
    return (num_joints + VECTOR_JOINTS - 1) // VECTOR_JOINTS


@kernel
@no_type_check
def _fill_rows(solver, flat_px, weights, start, stop):
    """Compute the rows of the views that have a joint of a block, and their norms (Chen et al. 2020, eq. 7-9 and 11).

    The block has the joints from ``start`` to before ``stop``. Returns the number of these views; the others would add
    only zeros to all sums.
    """
    num_views = 0
    num_vectors = count_vectors(stop - start)
    num_lanes = VECTOR_JOINTS * num_vectors
    solver.points[0].num_vectors = num_vectors
    for c in range(len(weights)):
        view, p = solver.views[num_views], solver.image_from_world[c]
        num_used = 0.0
        for k in range(stop - start):
            view.weight[k] = weights[c, start + k]
            num_used += 1.0 if view.weight[k] > 0 else 0.0
        if num_used == 0:
            continue
        num_views += 1
        p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
        p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
        p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
        for k in range(stop - start):
            view.px[0, k], view.px[1, k] = flat_px[c, 2 * (start + k)], flat_px[c, 2 * (start + k) + 1]
        for k in range(stop - start, num_lanes):
            view.weight[k] = 0.0
        for k in range(num_lanes):
            u, v, w = view.px[0, k], view.px[1, k], view.weight[k]
            used = (w > 0) & (w >= solver.min_weight) & (u + v == u + v)
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
    return num_views


@kernel
@no_type_check
def _reweigh(views, point, scale_m, far_m):
    """Weight views by Geman-McClure, ``(c^2 / (c^2 + d^2))^2``.

    The distance d is measured from the current point to both planes of a view, to first order the distance to its ray.
    Its square is stored in ``off2``, the number of views farther than ``far_m`` in ``num_far``. Computing the largest
    distance instead would need masked stores, which are slow.
    """
    num_lanes = VECTOR_JOINTS * point.num_vectors
    scale2, far2 = scale_m * scale_m, far_m * far_m
    point.num_far[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(num_lanes):
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
    num_lanes = VECTOR_JOINTS * point.num_vectors
    point.normal[:] = 0.0
    point.views[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(num_lanes):
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
    for k in range(num_lanes):
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
    num_lanes = VECTOR_JOINTS * point.num_vectors
    scale2 = scale_m * scale_m
    point.cost[:] = 0.0
    for c in range(len(views)):
        view = views[c]
        for k in range(num_lanes):
            x, y, z = point.xyz_m[0, k], point.xyz_m[1, k], point.xyz_m[2, k]
            first = view.rows[0, k] * x + view.rows[1, k] * y + view.rows[2, k] * z + view.rows[3, k]
            second = view.rows[4, k] * x + view.rows[5, k] * y + view.rows[6, k] * z + view.rows[7, k]
            squared = first * first * view.over2[0, k] + second * second * view.over2[1, k]
            cost = view.base2[k] * squared / (squared + scale2)
            point.cost[k] += cost if squared == squared else np.inf


@kernel
@no_type_check
def _median_around(xyz_m, frame, joint, axis, reach, window):
    """Median of a coordinate over a frame and its neighbours, NaN where the joint is unknown in all of them."""
    count = 0
    for other in range(max(frame - reach, 0), min(frame + reach + 1, xyz_m.shape[0])):
        value = xyz_m[other, joint, axis]
        if value == value:
            place = count
            while place > 0 and window[place - 1] > value:
                window[place] = window[place - 1]
                place -= 1
            window[place] = value
            count += 1
    if count == 0:
        return np.nan
    return 0.5 * (window[(count - 1) // 2] + window[count // 2])


@kernel
@no_type_check
def _triangulate_alone(views, point, scales_m, disputed_m):
    """Triangulate a frame by ``triangulation.triangulate_robust`` without a guess.

    ``num_far`` is set to the number of views that were farther than ``disputed_m`` before the last step.
    """
    _solve(views, point)
    _reweigh(views, point, scales_m[-1], scales_m[-2])
    num_far = 0.0
    num_lanes = VECTOR_JOINTS * point.num_vectors
    for k in range(num_lanes):
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
    num_lanes = VECTOR_JOINTS * point.num_vectors
    point.worst2[:] = 0.0
    for k in range(num_lanes):
        for axis in range(3):
            point.kept_m[axis, k] = point.xyz_m[axis, k]
    for c in range(len(views)):
        for k in range(num_lanes):
            point.worst2[k] = max(point.worst2[k], views[c].off2[k])
            worst2 = max(worst2, views[c].off2[k])
    for step in range(len(scales_m) - 1):
        if worst2 <= scales_m[step] * scales_m[step]:
            continue
        _reweigh(views, point, scales_m[step], np.inf)
        _solve(views, point)
        for k in range(num_lanes):
            needed = point.worst2[k] > scales_m[step] * scales_m[step]
            for axis in range(3):
                point.xyz_m[axis, k] = point.xyz_m[axis, k] if needed else point.kept_m[axis, k]
                point.kept_m[axis, k] = point.xyz_m[axis, k]


@kernel
@no_type_check
def triangulate_frame(solver, flat_px, weights, xyz_m, disputed):
    """Triangulate a frame by ``triangulation.triangulate_robust`` without a guess.

    - ``flat_px``: undistorted pixels, x and y of each joint in turn, (cameras, 2 * joints); NaN where unseen. A last
      axis of two would prevent vectorised loops, as kernels do not know its length.
    - ``weights``: factors of a view's rows, (cameras, joints).
    - ``xyz_m``: output: world coordinates in metres, (joints, 3), NaN where fewer than two cameras see the point.
    - ``disputed``: output: whether the views of a joint disagree, (joints,).
    """
    here = solver.points[0]
    for start in range(0, weights.shape[1], BLOCK_JOINTS):
        stop = min(start + BLOCK_JOINTS, weights.shape[1])
        num_views = _fill_rows(solver, flat_px, weights, start, stop)
        _triangulate_alone(solver.views[:num_views], here, solver.scales_m, solver.disputed_m)
        for k in range(stop - start):
            disputed[start + k] = here.num_far[k] > 0
            for axis in range(3):
                xyz_m[start + k, axis] = here.xyz_m[axis, k]


@kernel
@no_type_check
def _middle(a, b, c, d, e):
    """Median of five numbers."""
    low, high = max(min(a, b), min(c, d)), min(max(a, b), max(c, d))
    return max(min(low, high), min(max(low, high), e))


@kernel
@no_type_check
def guess_from_neighbours(solver, xyz_m, disputed, guess_m):
    """Compute the medians of disputed joints over neighbouring frames, and end the disputes that these do not support.

    ``xyz_m``: positions by ``triangulate_frame``, (frames, joints, 3). ``disputed``: disputes by ``triangulate_frame``,
    (frames, joints), changed in place: a dispute remains only if the median is far from the joint. ``guess_m``: output:
    medians at disputed joints, (frames, joints, 3).
    """
    num_frames, reach = xyz_m.shape[0], solver.reach
    for frame in range(num_frames):
        for k in range(xyz_m.shape[1]):
            if not disputed[frame, k]:
                continue
            total = np.nan
            if reach == 2 and 2 <= frame < num_frames - 2:
                total = 0.0
                for other in range(frame - 2, frame + 3):
                    total += xyz_m[other, k, 0] + xyz_m[other, k, 1] + xyz_m[other, k, 2]
            apart2 = 0.0
            for axis in range(3):
                if total == total:  # almost always five positions are known
                    a, b = xyz_m[frame - 2, k, axis], xyz_m[frame - 1, k, axis]
                    d, e = xyz_m[frame + 1, k, axis], xyz_m[frame + 2, k, axis]
                    guess_m[frame, k, axis] = _middle(a, b, xyz_m[frame, k, axis], d, e)
                else:
                    guess_m[frame, k, axis] = _median_around(xyz_m, frame, k, axis, reach, solver.window)
                apart2 += (guess_m[frame, k, axis] - xyz_m[frame, k, axis]) ** 2
            disputed[frame, k] = apart2 > solver.disputed_m * solver.disputed_m


@kernel
@no_type_check
def _from_guess(views, here, scales_m, disputed, guess_m, xyz_m):
    """Triangulate the disputed joints of a block from their guess; keep the position with the lower robust cost."""
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
def settle_frame(solver, flat_px, weights, disputed, guess_m, xyz_m):
    """Triangulate a frame's disputed joints again from their guesses; the lower robust cost wins.

    This is ``triangulation.triangulate_robust`` with a guess, after ``triangulate_frame`` and
    ``guess_from_neighbours``. ``xyz_m`` is changed in place where the guess wins.
    """
    for start in range(0, weights.shape[1], BLOCK_JOINTS):
        stop = min(start + BLOCK_JOINTS, weights.shape[1])
        if np.any(disputed[start:stop]):
            views = solver.views[: _fill_rows(solver, flat_px, weights, start, stop)]
            block = disputed[start:stop], guess_m[start:stop], xyz_m[start:stop]
            _from_guess(views, solver.points[0], solver.scales_m, *block)


@kernel
@no_type_check
def triangulate_all(solver, flat_px, weights, xyz_m, disputed, guess_m):
    """Triangulate consecutive frames; the parameters are the same as above, with a leading axis of frames."""
    for frame in range(len(flat_px)):
        triangulate_frame(solver, flat_px[frame], weights[frame], xyz_m[frame], disputed[frame])
    guess_from_neighbours(solver, xyz_m, disputed, guess_m)
    for frame in range(len(flat_px)):
        if np.any(disputed[frame]):
            settle_frame(solver, flat_px[frame], weights[frame], disputed[frame], guess_m[frame], xyz_m[frame])


@kernel
@no_type_check
def fill_gaps(xyz_m, max_gap, last_known, source):
    """Interpolate linearly, in place, over gaps of at most ``max_gap`` frames between two known positions.

    ``xyz_m``: world coordinates in metres, (frames, joints, 3), NaN where a joint is unknown; changed in place.
    ``last_known``: workspace, (joints,) of -1. ``source``: output: source of each joint, (frames, joints) of
    ``data.people.Source``.
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
