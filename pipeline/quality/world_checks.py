"""Checks of the world: people are upright, on the floor and of human size, and cameras are above the floor.

The usual cause of a failed check is the calibration: another up axis, another unit, or an origin off the floor.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.data import Camera, Floor, Reconstruction, Track3D
from pipeline.geometry.camera import center_in_world
from pipeline.joints import JointSet
from pipeline.quality.names import first_names
from pipeline.skeleton.feet.floor import ANKLE_HEIGHT_M

# Limit on the median angle from upright: people stand, walk or sit most of the time.
_MAX_LEAN_DEG = 45.0
_STATURE_RANGE_M = (1.0, 2.3)
# Limits on height and tilt of the floor that was estimated from the feet.
_MAX_FLOOR_M = 0.15
_MAX_TILT_DEG = 3.0

_HEAD = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_ANKLES = ("left_ankle", "right_ankle")


def _points_m(track: Track3D, joints: JointSet, names: Sequence[str]) -> Float[np.ndarray, "frames joints 3"]:
    return track.xyz_m[:, joints.indices(tuple(name for name in names if name in joints.names))]


def _mean_m(points_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames 3"]:
    """Mean of the known joints of each frame; NaN for frames without a known joint."""
    known = np.isfinite(points_m)
    count = known.sum(1)
    return np.where(known, points_m, 0.0).sum(1) / np.where(count > 0, count, np.nan)


def _feet_to_head_m(track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames 3"]:
    return _mean_m(_points_m(track, joints, _HEAD)) - _mean_m(_points_m(track, joints, _ANKLES))


def _floor_m(tracks: Sequence[Track3D], joints: JointSet) -> float:
    """Height of the floor: a low percentile of the ankles' heights, minus the height of an ankle; NaN if unknown."""
    heights_m = np.concatenate([np.zeros(0), *(_points_m(track, joints, _ANKLES)[..., 2].ravel() for track in tracks)])
    heights_m = heights_m[np.isfinite(heights_m)]
    return float(np.percentile(heights_m, 10)) - ANKLE_HEIGHT_M if len(heights_m) else np.nan


def world_checks(reconstruction: Reconstruction, statures_m: Mapping[int, float]) -> list[dict[str, str]]:
    """List the failed checks of the world, each with ``code`` and ``message``.

    Parameters
    ----------
    statures_m
        Stature in metres by track; NaN where unknown.
    """
    tracks, joints = reconstruction.tracks, reconstruction.joints
    checks = (
        _check_upright(tracks, joints),
        _check_floor(tracks, joints, reconstruction.animation.floor),
        _check_statures(statures_m),
        _check_cameras(reconstruction.cameras, _floor_m(tracks, joints)),
    )
    return [{"code": code, "message": message} for check in checks for code, message in check]


def _check_upright(tracks: Sequence[Track3D], joints: JointSet) -> Iterator[tuple[str, str]]:
    upwards = np.concatenate([np.zeros((0, 3)), *(_feet_to_head_m(track, joints) for track in tracks)])
    upwards = upwards[np.isfinite(upwards).all(-1)]
    if len(upwards) == 0:
        return
    lean_deg = np.degrees(np.arctan2(np.hypot(upwards[:, 0], upwards[:, 1]), upwards[:, 2]))
    if np.median(lean_deg) > 180.0 - _MAX_LEAN_DEG:
        yield "upside_down", "Heads are below feet: the calibration's Z axis points down."
    elif np.median(lean_deg) > _MAX_LEAN_DEG:
        yield (
            "not_upright",
            f"People lean {np.median(lean_deg):.0f} degrees in most frames: the calibration's up axis may not be Z.",
        )


def _check_floor(tracks: Sequence[Track3D], joints: JointSet, floor: Floor | None) -> Iterator[tuple[str, str]]:
    floor_m = _floor_m(tracks, joints)
    if abs(floor_m) > _MAX_FLOOR_M:
        yield "floor_not_at_zero", f"Feet stand at a height of {floor_m:.2f} m, not on the floor at 0."
    if floor is not None and floor.tilt_deg > _MAX_TILT_DEG:
        yield "floor_tilted", f"The floor that feet stand on is tilted by {floor.tilt_deg:.1f} degrees."


def _check_statures(statures_m: Mapping[int, float]) -> Iterator[tuple[str, str]]:
    lowest_m, highest_m = _STATURE_RANGE_M
    odd_m = {
        f"person-{track_id}": stature_m
        for track_id, stature_m in statures_m.items()
        if stature_m < lowest_m or stature_m > highest_m
    }
    if len(odd_m) == 1:
        ((person, stature_m),) = odd_m.items()
        yield (
            "stature_out_of_range",
            f"{person} is {stature_m:.2f} m tall: the unit of the calibration may not be the metre.",
        )
    elif odd_m:
        people = first_names([f"{person} ({stature_m:.2f} m)" for person, stature_m in odd_m.items()])
        yield (
            "stature_out_of_range",
            f"{len(odd_m)} people are not {lowest_m:g} to {highest_m:g} m tall: {people}. The unit of the calibration "
            "may not be the metre.",
        )


def _check_cameras(cameras: Sequence[Camera], floor_m: float) -> Iterator[tuple[str, str]]:
    below = [
        camera.name
        for camera in cameras
        if center_in_world(camera)[2] < (floor_m if np.isfinite(floor_m) else 0.0) - _MAX_FLOOR_M
    ]
    if below:
        yield "camera_below_floor", f"Cameras are below the floor: {first_names(below)}."
