"""Floor under the feet of all people, and what both the floor and the contacts need: speed, runs of frames."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d

from pipeline.core.data.animation import Floor, Side

SIDES: tuple[Side, Side] = ("left", "right")
ANKLE_HEIGHT_M = 0.065
"""Height of a standing adult's ankle above the floor (0.039 of stature)."""

MAX_HEIGHT_M, MAX_TILT_DEG = 0.15, 3.0
"""Largest height and tilt of a floor that counts as level at z = 0."""

# Smoothing time of the speed: faster movements are noise.
_SMOOTH_S = 0.03
# Resting foot: largest speed and shortest time.
_REST_M_S, _REST_S = 0.15, 0.2
# Scales of the distance between resting ankles and the floor plane, in order of the iterations; feet farther away do
# not rest on the floor.
_FLOOR_SCALES_M = (0.20, 0.10, 0.05, 0.03, 0.03, 0.03)
# Share of the lowest feet that are assumed to be on the floor. And the prior for a level plane: feet in a small area
# don't determine a slope.
_LOWEST_SHARE = 0.2
_SLOPE_SIGMA, _HEIGHT_SIGMA_M = 0.02, 0.02
# Shortest time for which a foot carries a person, and share of the feet that may be below the floor by mistake.
_CARRIES_S, _BELOW_SHARE = 0.3, 0.02
# Share of the feet from which on a plane above them is no floor.
_UNDER_SHARE = 0.05


def estimate_floor(
    ankles_m: Sequence[Float[np.ndarray, "_ 2 3"]],
    known: Sequence[Bool[np.ndarray, "_ 2"]],
    frame_rate_hz: float,
) -> Floor | None:
    """Fit a plane to the lowest resting feet of all people; ``None`` if no foot is known.

    If no foot ever rests, the plane is fitted to the lowest positions of all feet. The fit is robust by iterative
    reweighting (Geman and McClure). A weak prior keeps the plane level. The ankles are the left and the right one of
    each person; ``known`` are the frames in which they were located.
    """
    resting = [_resting_m(ankles, seen, frame_rate_hz) for ankles, seen in zip(ankles_m, known, strict=True)]
    points_m = np.concatenate([np.zeros((0, 3)), *resting])
    if not len(points_m):
        points_m = np.concatenate(
            [np.zeros((0, 3)), *(ankles[seen] for ankles, seen in zip(ankles_m, known, strict=True))]
        )
        if not len(points_m):
            return None
        lowest = points_m[:, 2] <= np.quantile(points_m[:, 2], _LOWEST_SHARE)
        points_m = points_m[lowest]
    return fit_floor(points_m)


def shared_floor(
    ankles_m: Sequence[Float[np.ndarray, "_ 2 3"]],
    known: Sequence[Bool[np.ndarray, "_ 2"]],
    carries: Sequence[Bool[np.ndarray, "_ 2"]],
    frame_rate_hz: float,
) -> Floor | None:
    """Floor under the feet that carry upright people, see ``estimate_floor``.

    Without standing people it is the world's level at z = 0, unless feet were below it. A plane with feet below it is
    a bar or a box on which a person stood; then only the lowest feet count. ``carries`` are the frames in which a foot
    may carry its person, ``known`` those in which it was located.
    """
    located_m = np.concatenate(
        [np.zeros((0, 3)), *(points[seen] for points, seen in zip(ankles_m, known, strict=True))]
    )
    lowest_m = float(np.quantile(located_m[:, 2], _BELOW_SHARE)) if len(located_m) else np.inf
    low = [feet & (points[..., 2] < lowest_m + MAX_HEIGHT_M) for points, feet in zip(ankles_m, carries, strict=True)]
    for feet_on_floor in (carries, low):
        stands = [feet if feet.sum() >= _CARRIES_S * frame_rate_hz else np.zeros_like(feet) for feet in feet_on_floor]
        floor = estimate_floor(ankles_m, stands, frame_rate_hz) if any(feet.any() for feet in stands) else None
        if floor is not None and (floor.height_m(located_m) < -MAX_HEIGHT_M).mean() <= _UNDER_SHARE:
            return floor
    return Floor(0.0, 0.0, 0.0) if -MAX_HEIGHT_M <= lowest_m < np.inf else None


def fit_floor(points_m: Float[np.ndarray, "points 3"]) -> Floor:
    """Fit a plane to the lowest of some positions of ankles, robustly; a weak prior keeps it level."""
    center_m = points_m.mean(0)
    design = np.column_stack([np.ones(len(points_m)), points_m[:, :2] - center_m[:2]])
    plane = np.array([np.quantile(points_m[:, 2], _LOWEST_SHARE), 0.0, 0.0])
    level = np.diag([0.0, 1.0, 1.0]) * (_HEIGHT_SIGMA_M / _SLOPE_SIGMA) ** 2
    for scale_m in _FLOOR_SCALES_M:
        off_m = points_m[:, 2] - design @ plane
        weight = (scale_m**2 / (scale_m**2 + off_m**2)) ** 2
        plane = np.linalg.solve((design * weight[:, None]).T @ design + level, design.T @ (weight * points_m[:, 2]))
    slope = plane[1:]
    return Floor(float(plane[0] - slope @ center_m[:2]) - ANKLE_HEIGHT_M, float(slope[0]), float(slope[1]))


def speed_m_s(
    point_m: Float[np.ndarray, "frames *points 3"], frame_rate_hz: float, smooth_s: float = _SMOOTH_S
) -> Float[np.ndarray, "frames *points"]:
    """Speed of points of feet in metres a second, smoothed."""
    if len(point_m) < 2:
        return np.zeros(point_m.shape[:-1])
    smooth_m = gaussian_filter1d(point_m, smooth_s * frame_rate_hz, axis=0, mode="nearest")
    return np.asarray(np.linalg.norm(np.gradient(smooth_m, axis=0), axis=-1) * frame_rate_hz)


def find_runs(mask: Bool[np.ndarray, " frames"]) -> list[tuple[int, int]]:
    """Ranges of frames (start, stop) in which a mask is true."""
    borders = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [(int(start), int(stop)) for start, stop in borders.reshape(-1, 2)]


def _resting_m(
    ankles_m: Float[np.ndarray, "frames 2 3"], known: Bool[np.ndarray, "frames 2"], frame_rate_hz: float
) -> Float[np.ndarray, "_ 3"]:
    """Ankle positions of resting feet: one point for each 0.2 s of a rest."""
    points = [np.zeros((0, 3))]
    step = max(1, round(_REST_S * frame_rate_hz))
    for foot in range(2):
        slow = (speed_m_s(ankles_m[:, foot], frame_rate_hz) < _REST_M_S) & known[:, foot]
        for start, stop in find_runs(slow):
            count = (stop - start) // step
            points.append(ankles_m[start : start + count * step, foot].reshape(count, step, 3).mean(1))
    return np.concatenate(points)
