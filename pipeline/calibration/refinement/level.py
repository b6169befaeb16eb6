"""Levelling of the world: the floor under the feet of the people becomes z = 0, as far as they determine it.

Three witnesses tell what is level: the ground that feet stand on, the direction in which people stand upright, and how
the cameras stand. The floor turns the world only if feet reach far enough to determine its slope, and if upright people
agree: people stand upright on a ramp, too. Cameras that stand upright in the given world outweigh people who lie.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.vertical import cameras_allow, turn_upright, upright_direction
from pipeline.core.data.animation import Floor
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Poses3D
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet
from pipeline.geometry.tracks import triangulate_instants
from pipeline.motion.skeleton.feet.floor import MAX_HEIGHT_M, MAX_TILT_DEG, fit_floor

_MIN_SCORE = 0.3
_MIN_POSES = 40
# A standing foot is this close to the floor, and at least so many of the lower feet are.
_NEAR_M, _MIN_SHARE = 0.06, 0.6
# Standard deviation of the height of the feet in a square of the floor: errors of detectors and of cameras differ from
# place to place, not from frame to frame.
_CELL_M, _CELL_SIGMA_M = 0.5, 0.015
# Largest standard deviation of a slope that turns the world, in radians.
_MAX_SLOPE_SIGMA = np.radians(0.75)
# Largest angle between the floor's normal and upright people, and the angle from Z beyond which these alone are enough.
_AGREE_DEG, _CLEAR_DEG = 5.0, 10.0
# Largest lean of a body that its feet carry, and height of hands above the shoulders by which a body may hang.
_MAX_LEAN_RAD, _OVERHEAD_M = np.radians(45.0), 0.2
# The last digits depend on the number of threads of the linear algebra.
_DECIMALS = 7


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Move of the world that puts the floor to z = 0."""

    # Transform from the given world: the shortest turn about the people's place, and a shift along Z
    level_from_given: Rigid3
    tilt_deg: float  # Angle by which the world turns
    height_m: float  # Height of the floor in the given world, in the middle of the people


def find_level(cameras: Sequence[Camera], poses: Sequence[Poses3D], joints: JointSet) -> Level | None:
    """Find the move that levels the world.

    ``cameras``: cameras of the given world, by which the feet are located. ``poses``: poses of people, such as from
    ``sightings.sampled_poses``; only their 2D joints are used. Returns ``None`` if the world is level, or if the people
    don't determine the floor.
    """
    needed = ("left_ankle", "right_ankle", "left_shoulder", "right_shoulder")
    if not set(needed) <= set(joints.names) or sum(len(some.frame) for some in poses) < _MIN_POSES:
        return None
    wrists = tuple(name for name in ("left_wrist", "right_wrist") if name in joints.names)
    xyz_m = _located_m(cameras, poses, joints.indices((*needed, *wrists)))
    ankles_m, shoulders_m, wrists_m = xyz_m[:, :2], xyz_m[:, 2:4], xyz_m[:, 4:]
    up = upright_direction(shoulders_m, ankles_m)
    if up is None:
        return None
    rotation = _rotation(up, ankles_m[np.isfinite(ankles_m).all((-1, -2))])
    if not cameras_allow(cameras, rotation[2]):
        rotation = np.eye(3)
    rotation = np.round(rotation, _DECIMALS)
    ankles_m = ankles_m[_stands(ankles_m, shoulders_m, wrists_m, rotation[2])]
    if len(ankles_m) < _MIN_POSES:
        return None
    turned_m = ankles_m @ rotation.T
    feet_m = _lower(turned_m)
    floor = fit_floor(feet_m)
    near = _is_near(feet_m, floor)
    if near.mean() < _MIN_SHARE:
        return None
    x_m, y_m = np.round(np.median(feet_m[near, :2], axis=0), _DECIMALS).tolist()
    height_m = round(floor.z_m + floor.slope_x * x_m + floor.slope_y * y_m, _DECIMALS)
    tilt_deg = float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))))
    if tilt_deg <= MAX_TILT_DEG and abs(height_m) <= MAX_HEIGHT_M:
        return None
    # The place on the floor under the middle of the people keeps its x and y.
    place_m = rotation.T @ np.array([x_m, y_m, height_m])
    shift_m = np.array([place_m[0], place_m[1], 0.0]) - rotation @ place_m
    return Level(_rigid(rotation, shift_m), tilt_deg, float(place_m[2]))


def _stands(
    ankles_m: Float[np.ndarray, "poses 2 3"],
    shoulders_m: Float[np.ndarray, "poses 2 3"],
    wrists_m: Float[np.ndarray, "poses wrists 3"],
    up: Float[np.ndarray, " 3"],
) -> Bool[np.ndarray, " poses"]:
    """Poses in which the feet may carry the body: it is upright, and does not hang by its hands."""
    body_m = shoulders_m.mean(1) - ankles_m.mean(1)
    reach_m = (wrists_m - shoulders_m.mean(1)[:, None]) @ up
    hangs = (reach_m > _OVERHEAD_M).all(-1) & (reach_m.shape[1] > 0)
    # Comparisons with NaN are false.
    return np.asarray((body_m @ up > np.cos(_MAX_LEAN_RAD) * np.linalg.norm(body_m, axis=-1)) & ~hangs)


def _rigid(rotation: Float[np.ndarray, "3 3"], shift_m: Float[np.ndarray, " 3"]) -> Rigid3:
    left, _, right = np.linalg.svd(rotation)  # rounding took the last digits of orthonormality
    return Rigid3(read_only(left @ right), read_only(shift_m))


def _located_m(
    cameras: Sequence[Camera], poses: Sequence[Poses3D], index: Sequence[int]
) -> Float[np.ndarray, "poses joints 3"]:
    parts = [
        np.where(some.score[:, list(index), :, None] >= _MIN_SCORE, some.points_px[:, list(index)], np.nan)
        for some in poses
    ]
    points_px = np.concatenate(parts)
    return triangulate_instants(cameras, points_px.swapaxes(1, 2))


def _rotation(up: Float[np.ndarray, " 3"], ankles_m: Float[np.ndarray, "poses 2 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation that levels the world: by the floor, by upright people alone, or none."""
    upright = turn_upright(up)
    feet_m = _lower(ankles_m @ upright.T)
    floor = fit_floor(feet_m)
    near = _is_near(feet_m, floor)
    if near.mean() >= _MIN_SHARE and _slope_sigma(feet_m[near]) <= _MAX_SLOPE_SIGMA and floor.tilt_deg <= _AGREE_DEG:
        normal = upright.T @ np.array([-floor.slope_x, -floor.slope_y, 1.0])
        return turn_upright(normal)
    is_clear = up[2] < np.cos(np.radians(_CLEAR_DEG))
    return upright if is_clear else np.eye(3)


def _lower(ankles_m: Float[np.ndarray, "poses 2 3"]) -> Float[np.ndarray, "poses 3"]:
    """The lower ankle of each pose: the standing foot's."""
    return np.asarray(ankles_m[np.arange(len(ankles_m)), np.argmin(ankles_m[..., 2], axis=1)])


def _is_near(feet_m: Float[np.ndarray, "feet 3"], floor: Floor) -> np.ndarray:
    plane_m = floor.z_m + feet_m[:, :2] @ np.array([floor.slope_x, floor.slope_y])
    off_m = feet_m[:, 2] - plane_m
    return np.asarray(np.abs(off_m - np.median(off_m)) <= _NEAR_M)


def _slope_sigma(feet_m: Float[np.ndarray, "feet 3"]) -> float:
    """Standard deviation of the floor's slope along the direction in which feet reach least far."""
    cells = np.unique(np.floor(feet_m[:, :2] / _CELL_M), axis=0) * _CELL_M
    spread = np.linalg.eigvalsh((cells - cells.mean(0)).T @ (cells - cells.mean(0)))[0]
    return float(_CELL_SIGMA_M / np.sqrt(max(spread, 1e-12)))
