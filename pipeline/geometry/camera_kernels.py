"""Compiled reprojection of whole tracks, and undistortion; ``camera.py`` is the same in plain NumPy."""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.core.runtime.jit import kernel, record_dtype, zero_records
from pipeline.geometry.camera import twelve_coefficients
from pipeline.geometry.fisheye import angle_limit_rad
from pipeline.geometry.kernels import BLOCK_JOINTS, POINT_DTYPE, VECTOR_JOINTS, VIEW_DTYPE, count_vectors


@cache
def block_dtype(size: int) -> np.dtype:
    """Record of a block of points for undistortion."""
    values = ((name, np.float64, (size,)) for name in ("x", "y", "goal_x", "goal_y"))
    return record_dtype(*values, ("place", np.int64, (size,)))


class Lenses(NamedTuple):
    """Cameras of a reprojection, and workspace: kernels allocate no memory."""

    poses: np.ndarray  # (cameras, 3, 4): extrinsics [R | t]
    matrices: np.ndarray  # (cameras, 3, 3)
    distortions: np.ndarray  # (cameras, 12), in the order of camera.distort; of a fisheye its four coefficients
    fisheye_limit_rad: np.ndarray  # (cameras,): angle limit of a fisheye, 0 for the standard model
    min_weight: float  # an observation is used if its weight is above 0 and at least this
    points: np.ndarray  # (1,) of kernels.POINT_DTYPE
    views: np.ndarray  # (1,) of kernels.VIEW_DTYPE


def make_lenses(cameras: Sequence[Camera], min_weight: float) -> Lenses:
    """Gather the cameras in arrays, and allocate the workspace."""
    return Lenses(
        np.array([camera.cam_from_world.matrix for camera in cameras]),
        np.array([camera.matrix for camera in cameras]),
        np.array([twelve_coefficients(camera.distortion) for camera in cameras]),
        np.array([angle_limit_rad(camera.distortion) if camera.lens == "fisheye" else 0.0 for camera in cameras]),
        float(min_weight),
        zero_records(1, POINT_DTYPE),
        zero_records(1, VIEW_DTYPE),
    )


@kernel
@no_type_check
def _add_errors(here, view, p, m, d):
    """Project the joints into a camera with distortion, and add their reprojection errors."""
    p00, p01, p02, p03 = p[0, 0], p[0, 1], p[0, 2], p[0, 3]
    p10, p11, p12, p13 = p[1, 0], p[1, 1], p[1, 2], p[1, 3]
    p20, p21, p22, p23 = p[2, 0], p[2, 1], p[2, 2], p[2, 3]
    m00, m01, m02, m10, m11, m12 = m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2]
    k1, k2, p1, p2, k3, k4, k5, k6 = d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]
    s1, s2, s3, s4 = d[8], d[9], d[10], d[11]
    num_lanes = VECTOR_JOINTS * here.num_vectors
    for k in range(num_lanes):
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
def _add_fisheye_errors(here, view, p, m, d, limit_rad):
    """Project the joints into a camera with a fisheye lens (``fisheye.py``), and add their errors."""
    num_lanes = VECTOR_JOINTS * here.num_vectors
    for k in range(num_lanes):
        x, y, z = here.xyz_m[0, k], here.xyz_m[1, k], here.xyz_m[2, k]
        depth = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
        over = 1.0 / depth if depth > 1e-6 else np.nan
        u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) * over
        v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) * over
        ideal = np.sqrt(u * u + v * v)
        angle = np.arctan(ideal)
        a2 = angle * angle
        radius = angle * (1 + a2 * (d[0] + a2 * (d[1] + a2 * (d[2] + a2 * d[3]))))
        ratio = radius / ideal if ideal > 1e-9 else 1.0
        ratio = ratio if angle <= limit_rad else np.nan
        dx = (m[0, 0] * u + m[0, 1] * v) * ratio + m[0, 2] - view.px[0, k]
        dy = (m[1, 0] * u + m[1, 1] * v) * ratio + m[1, 2] - view.px[1, k]
        off_px = np.sqrt(dx * dx + dy * dy)
        here.cost[k] += off_px if view.weight[k] > 0 else 0.0
        here.weight_sum[k] += view.weight[k]
        here.views[k] += 1.0 if view.weight[k] > 0 else 0.0


@kernel
@no_type_check
def _reproject_block(lenses, xyz_m, flat_px, weights, error_px, mean_weight, views, start, stop):
    """Reproject the joints from ``start`` to before ``stop``, as ``reproject_frame`` does."""
    here, view = lenses.points[0], lenses.views[0]
    here.num_vectors = count_vectors(stop - start)
    here.cost[:] = 0.0
    here.views[:] = 0.0
    here.weight_sum[:] = 0.0
    view.weight[:] = 0.0
    for k in range(stop - start):
        for axis in range(3):
            here.xyz_m[axis, k] = xyz_m[start + k, axis]
    for c in range(weights.shape[0]):
        num_used = 0.0
        for k in range(stop - start):
            weight = weights[c, start + k]
            view.weight[k] = weight if weight >= lenses.min_weight else 0.0
            num_used += 1.0 if weight > 0 else 0.0
        if num_used == 0:  # it would add only zeros
            continue
        for k in range(stop - start):
            view.px[0, k], view.px[1, k] = flat_px[c, 2 * (start + k)], flat_px[c, 2 * (start + k) + 1]
        limit_rad = lenses.fisheye_limit_rad[c]
        if limit_rad > 0:
            _add_fisheye_errors(here, view, lenses.poses[c], lenses.matrices[c], lenses.distortions[c], limit_rad)
        else:
            _add_errors(here, view, lenses.poses[c], lenses.matrices[c], lenses.distortions[c])
    for k in range(stop - start):
        seen = here.views[k]
        error, weight = here.cost[k] / seen, here.weight_sum[k] / seen
        located = (seen > 0) & (error == error)
        views[start + k] = seen if located else 0.0
        error_px[start + k] = error if located else np.nan
        mean_weight[start + k] = weight if located else 0.0


@kernel
@no_type_check
def reproject_frame(lenses, xyz_m, flat_px, weights, error_px, mean_weight, views):
    """Compute the mean reprojection error over the cameras that saw a joint, and the number of these cameras.

    - ``xyz_m``: world coordinates in metres, (joints, 3).
    - ``flat_px``: distorted pixels, x and y of each joint in turn, (cameras, 2 * joints).
    - ``weights``: weights of observations, (cameras, joints).
    - ``error_px``: output: error in pixels, (joints,), NaN where no camera saw the joint or the joint is unknown.
    - ``mean_weight``, ``views``: output: mean weight and number of the cameras that saw the joint, (joints,); 0 where
      there is no error.
    """
    for start in range(0, weights.shape[1], BLOCK_JOINTS):
        stop = min(start + BLOCK_JOINTS, weights.shape[1])
        _reproject_block(lenses, xyz_m, flat_px, weights, error_px, mean_weight, views, start, stop)


@kernel
@no_type_check
def reproject_all(lenses, xyz_m, flat_px, weights, error_px, mean_weight, views):
    """Reproject several frames; the parameters of ``reproject_frame`` have a leading axis of frames."""
    for n in range(len(weights)):
        reproject_frame(lenses, xyz_m[n], flat_px[n], weights[n], error_px[n], mean_weight[n], views[n])


@kernel
@no_type_check
def undistort(points, d, num_steps, tolerance, blocks):
    """Invert ``camera.distort`` in place by Newton's method with the exact Jacobian; (points, 2), NaN stays NaN.

    Points are processed in blocks; ``blocks`` is the workspace for a block, (1,) of ``block_dtype``.
    """
    block = blocks[0]
    size = block.x.shape[0]
    k1, k2, p1, p2, k3, k4, k5, k6 = d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]
    s1, s2, s3, s4 = d[8], d[9], d[10], d[11]
    start = 0
    while start < len(points):
        num_known = 0
        while start < len(points) and num_known < size:
            if points[start, 0] == points[start, 0]:
                block.place[num_known] = start
                block.goal_x[num_known], block.goal_y[num_known] = points[start, 0], points[start, 1]
                block.x[num_known], block.y[num_known] = points[start, 0], points[start, 1]
                num_known += 1
            start += 1
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
                # Beyond the image, where the distortion model folds over, the determinant is not positive: keep the
                # point there, for the iteration would diverge.
                over = over if determinant > 1e-3 else 0.0
                block.x[i] = u - (vv * off_u - uv * off_v) * over
                block.y[i] = v - (uu * off_v - vu * off_u) * over
                num_open += 1.0 if (off_u * off_u + off_v * off_v) * over > tolerance * tolerance else 0.0
            if num_open == 0:
                break
        for i in range(num_known):
            points[block.place[i], 0], points[block.place[i], 1] = block.x[i], block.y[i]
