"""Liveliness of a person over time: ratio of their accelerations to usual ones, where it is clearly above 1.

Joints located in each frame by itself tremble by the noise of the detector, and their second differences contain it.
The views tell how large it is: the residuals of the rays around the located joint give its covariance (as in the a
posteriori variance of a least squares adjustment). Second differences beyond that are motion. With
independent accelerations of variance ``u^2`` in each frame, which the fit's prior assumes, the difference over a lag of
L frames on both sides has the variance ``u^2 L (2 L^2 + 1) / 3``; the noise's variance does not grow with the lag.
Errors in which the views differ, but which last in time, seem to be noise, and make no person lively.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import LIMBS, JointSet
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.time_series import Blend, windows

# Lag of the second differences on both sides, span of time that has one liveliness, and time over which the noise of a
# joint is measured.
_LAG_S, _SPAN_S, _NOISE_S = 0.05, 0.5, 1.0
# Scale c of the rays at which joints are located by themselves, in steps from the position that association gave. It is
# wide, so that the weights do not make residuals small.
_SCALE_M, _NUM_STEPS = 0.20, 3
# Number of observations that the noise of all joints counts for, and for all joints the noise promised by scores.
_NUM_SHARED = 50
# Median of the squared length of a vector of three normal components, over its mean.
_MEDIAN_SHARE = 0.789
# Standard errors by which accelerations must exceed usual ones; relative standard error of that median for one
# difference; and number of differences that count as one, as neighbours share positions.
_SIGNIFICANT, _MEDIAN_ERROR, _LASTING = 2.0, 1.12, 3.0
# Variance of the noise over the measured one, at most: the weights of rays make residuals smaller.
_NOISIER = 1.25
# Differences in a span that tell anything.
_MIN_DIFFERENCES = 30
# Precision in 1 / m2 that rays have at least, so that parallel ones can be solved for.
_INERTIA = 1.0


def liveliness(
    track: Track3D,
    rays_of: Callable[[slice], Rays],
    usual_m: Float[np.ndarray, " joints"],
    joints: JointSet,
    frame_rate_hz: float,
) -> Float[np.ndarray, " frames"]:
    """Ratio of a person's accelerations to usual ones in each frame, at least 1.

    ``track``: joints as located by association. ``rays_of``: returns the rays in a window of frames. ``usual_m``: usual
    second difference of each joint's position between frames, in metres.
    """
    of_limbs = sorted({joints.index(name) for limb in LIMBS for name in limb if name in joints.names})
    ratio = np.ones(track.num_frames)
    if not of_limbs:
        return ratio
    blend = Blend(ratio)
    for rows in windows(track.num_frames):
        rays = rays_of(rows)
        rays.exchange_sides(track.xyz_m[rows], _SCALE_M)
        is_measured = track.source[rows] == Source.MEASURED
        located = [_locate(rays, joint, track.xyz_m[rows, joint], is_measured[:, joint]) for joint in of_limbs]
        xyz_m, variance_m2, residual, freedom = (np.stack(values, axis=1) for values in zip(*located, strict=True))
        variance_m2 *= _noise(residual, freedom, frame_rate_hz)
        blend.add(rows, _ratio(xyz_m, variance_m2, usual_m[of_limbs], frame_rate_hz))
    return ratio


def _locate(
    rays: Rays, joint: int, start_m: Float[np.ndarray, "frames 3"], is_measured: Bool[np.ndarray, " frames"]
) -> tuple[
    Float[np.ndarray, "frames 3"],
    Float[np.ndarray, " frames"],
    Float[np.ndarray, " frames"],
    Float[np.ndarray, " frames"],
]:
    """Locate a joint by its rays in each frame alone.

    Returns its positions, the sum of their variances along the three axes as the scores promise it, the weighted sum of
    squared residuals, and their degrees of freedom. In frames in which fewer than two views see the joint, the first
    two are NaN and the others 0.
    """
    xyz_m = np.nan_to_num(start_m)
    for _ in range(_NUM_STEPS):
        normal, right = rays.normal_equations(joint, xyz_m, _SCALE_M)
        normal += _INERTIA * np.eye(3)
        xyz_m = np.linalg.solve(normal, (right + _INERTIA * xyz_m)[..., None])[..., 0]
    residual, num_views = rays.residuals(joint, xyz_m, _SCALE_M)
    is_known = is_measured & (num_views > 1)
    variance_m2 = np.trace(np.linalg.inv(normal), axis1=1, axis2=2)
    return (
        np.where(is_known[:, None], xyz_m, np.nan),
        np.where(is_known, variance_m2, np.nan),
        np.where(is_known, residual, 0.0),
        # Two coordinates of each view, less the three of the joint.
        np.where(is_known, 2.0 * num_views - 3.0, 0.0),
    )


def _noise(
    residual: Float[np.ndarray, "frames joints"], freedom: Float[np.ndarray, "frames joints"], frame_rate_hz: float
) -> Float[np.ndarray, "frames joints"]:
    """Variance of the noise in relation to what the scores promise, of each joint around each frame.

    For joints with few observations it is closer to the noise of all joints, and for people with few to the promise.
    """
    reach = 2 * round(_NOISE_S * frame_rate_hz / 2) + 1
    residual, freedom = (
        reach * uniform_filter1d(values, reach, axis=0, mode="constant") for values in (residual, freedom)
    )
    of_all = (residual.sum(1, keepdims=True) + _NUM_SHARED) / (freedom.sum(1, keepdims=True) + _NUM_SHARED)
    return np.asarray((residual + _NUM_SHARED * of_all) / (freedom + _NUM_SHARED))


def _ratio(
    xyz_m: Float[np.ndarray, "frames joints 3"],
    variance_m2: Float[np.ndarray, "frames joints"],
    usual_m: Float[np.ndarray, " joints"],
    frame_rate_hz: float,
) -> Float[np.ndarray, " frames"]:
    """Ratio of accelerations to usual ones, from spans that overlap by half; linear between their middles."""
    lag, span = max(1, round(_LAG_S * frame_rate_hz)), max(2, round(_SPAN_S * frame_rate_hz))
    if len(xyz_m) <= 2 * lag:
        return np.ones(len(xyz_m))
    before, middle, after = slice(None, -2 * lag), slice(lag, -lag), slice(2 * lag, None)
    squared_m2 = ((xyz_m[after] - 2 * xyz_m[middle] + xyz_m[before]) ** 2).sum(-1)
    noise_m2 = _NOISIER * (variance_m2[after] + 4 * variance_m2[middle] + variance_m2[before])
    usual_m2 = usual_m**2 * lag * (2 * lag**2 + 1) / 3
    starts = np.arange(0, max(len(squared_m2) - span // 2, 1), span // 2)
    ratios = [
        _ratio_of_span(squared_m2[rows], noise_m2[rows], usual_m2)
        for rows in (slice(start, start + span) for start in starts)
    ]
    return np.interp(np.arange(len(xyz_m)), starts + lag + span / 2, ratios)


def _ratio_of_span(
    squared_m2: Float[np.ndarray, "differences joints"],
    noise_m2: Float[np.ndarray, "differences joints"],
    usual_m2: Float[np.ndarray, " joints"],
) -> float:
    """Lowest ratio, at least 1, with which the median of squared differences is as expected within its error."""
    known = np.isfinite(squared_m2)
    num_known = int(known.sum())
    if num_known < _MIN_DIFFERENCES:
        return 1.0
    highest = _MEDIAN_SHARE * (1 + _SIGNIFICANT * _MEDIAN_ERROR / np.sqrt(num_known / _LASTING))
    # The median of squared / (noise + ratio^2 usual) equals ``highest`` where the median of this is the squared ratio.
    ratio2 = np.median(((squared_m2 / highest - noise_m2) / usual_m2)[known])
    return float(np.sqrt(max(ratio2, 1.0)))
