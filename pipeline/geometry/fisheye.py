"""Fisheye lens of Kannala and Brandt with OpenCV's four coefficients, on the normalised image plane.

A point at the angle t from the optical axis appears at the radius ``t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)``
(OpenCV, module ``fisheye``; Kannala and Brandt 2006, "A generic camera model", eq. 6). The reconstruction works on
the image of an ideal pinhole camera, so points count as seen only up to ``MAX_ANGLE_RAD`` from the axis, and only as
far as the radius grows with the angle.
"""

import numpy as np
from jaxtyping import Float

MAX_ANGLE_RAD = np.radians(85.0)
"""Largest angle from the axis: a pinhole image of a point there is 11 focal lengths from the centre."""

NUM_COEFFICIENTS = 4
# Radius below which the ratio of the radii is 1 to machine precision.
_TINY = 1e-9
# Newton's method with bisection: steps for the full precision from any start.
_MAX_STEPS = 60
_TOLERANCE = 1e-14

Coefficients = Float[np.ndarray, " 4"]
Points = Float[np.ndarray, "*batch 2"]


def angle_limit_rad(distortion: Coefficients) -> float:
    """Angle up to which the radius grows, at most ``MAX_ANGLE_RAD``."""
    # Zeros of the slope in 1 / t^2: a monic polynomial, so that small coefficients don't overflow.
    roots = np.roots([1.0, *(np.array([3.0, 5.0, 7.0, 9.0]) * distortion)])
    inverse_squares = roots[(np.abs(roots.imag) < 1e-9) & (roots.real > MAX_ANGLE_RAD**-2)].real
    return float(np.min([MAX_ANGLE_RAD, *inverse_squares**-0.5]))


def radius(angle_rad: Float[np.ndarray, "*batch"], distortion: Coefficients) -> Float[np.ndarray, "*batch"]:
    """Radius on the image plane of points at angles from the axis."""
    k1, k2, k3, k4 = distortion
    t2 = angle_rad * angle_rad
    return angle_rad * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _slope(angle_rad: Float[np.ndarray, "*batch"], distortion: Coefficients) -> Float[np.ndarray, "*batch"]:
    """Derivative of the radius by the angle."""
    k1, k2, k3, k4 = distortion
    t2 = angle_rad * angle_rad
    return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))


def distort_fisheye(points: Points, distortion: Coefficients) -> Points:
    """Distort points of the pinhole image; NaN beyond the angle limit, and for NaN."""
    ideal = np.linalg.norm(points, axis=-1, keepdims=True)
    angle_rad = np.arctan(ideal)
    ratio = np.where(ideal > _TINY, radius(angle_rad, distortion) / np.maximum(ideal, _TINY), 1.0)
    return points * np.where(angle_rad <= angle_limit_rad(distortion), ratio, np.nan)


def undistort_fisheye(points: Points, distortion: Coefficients) -> Points:
    """Invert ``distort_fisheye``; NaN where no point within the angle limit is seen, and for NaN."""
    seen = np.linalg.norm(points, axis=-1, keepdims=True)
    limit_rad = angle_limit_rad(distortion)
    # Below the limit the radius grows, so the angle is unique: each step halves the range at least.
    low, high = np.zeros_like(seen), np.full_like(seen, limit_rad)
    angle_rad = np.minimum(seen, limit_rad)
    for _ in range(_MAX_STEPS):
        off = radius(angle_rad, distortion) - seen
        low, high = np.where(off < 0, angle_rad, low), np.where(off > 0, angle_rad, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = angle_rad - off / _slope(angle_rad, distortion)
        following = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
        is_open = np.abs(following - angle_rad) > _TOLERANCE
        angle_rad = following
        if not is_open.any():
            break
    is_seen = seen <= radius(np.array([limit_rad]), distortion)
    ratio = np.where(seen > _TINY, np.tan(angle_rad) / np.maximum(seen, _TINY), 1.0)
    return points * np.where(is_seen, ratio, np.nan)


def fisheye_by_ideal(
    points: Float[np.ndarray, "points 2"], distortion: Coefficients
) -> Float[np.ndarray, "points 2 2"]:
    """Derivatives of ``distort_fisheye`` by the points."""
    ideal = np.maximum(np.linalg.norm(points, axis=-1), _TINY)
    angle_rad = np.arctan(ideal)
    ratio = radius(angle_rad, distortion) / ideal
    # Along the ray from the centre the radius changes by its slope, across it the ratio stays.
    along = _slope(angle_rad, distortion) / (1 + ideal * ideal)
    unit = points / ideal[:, None]
    return (along - ratio)[:, None, None] * unit[:, :, None] * unit[:, None, :] + ratio[:, None, None] * np.eye(2)


def fisheye_by_coefficients(points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2 4"]:
    """Derivatives of ``distort_fisheye`` by the four coefficients."""
    ideal = np.maximum(np.linalg.norm(points, axis=-1), _TINY)
    powers = np.arctan(ideal)[:, None] ** np.array([3, 5, 7, 9])
    return points[:, :, None] * (powers / ideal[:, None])[:, None, :]
