"""The vertical of people and of cameras, and rotations that turn it to Z."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.calibration.contents import CameraFile
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.options.job_choices import Up

AXES: Mapping[str, Float[np.ndarray, " 3"]] = {
    f"{sign}{name}": side * unit
    for sign, side in (("", 1.0), ("-", -1.0))
    for name, unit in zip("xyz", np.eye(3), strict=True)
}
"""Axes of a world and their opposites, by name, such as ``-y``."""

# Distance from ankles to shoulders, as a share of its largest values, at which a person stands upright.
_UPRIGHT, _LARGEST = 0.97, 95
_ITERATIONS, _LEAN_RAD = 10, np.radians(4.0)
# Least length of the mean of the cameras' up directions at which it is a direction.
_MIN_MEAN_UP = 0.6
# Most that cameras look up, and that an edge of a picture slopes, as sines; and the share of cameras that must fit.
_MAX_RISE, _MAX_SLOPE, _MIN_SHARE = np.sin(np.radians(30.0)), np.sin(np.radians(20.0)), 0.8
# Evidence of a camera for a vertical, in nats. Standard deviations of its roll, and of the angle by which it looks up
# beyond a limit; each counts up to three of them. A camera that hangs on its side or upside down is unlikely.
_ROLL_RAD, _RISE_RAD, _LEVEL_RAD = np.radians(2.5), np.radians(15.0), np.radians(10.0)
_MOST, _HANGS_TURNED = 4.5, 1.0
# Evidence against a turn that refuses it; beyond this angle, a turn needs as much evidence for it.
_MIN_EVIDENCE, _LARGE_TURN_RAD = 2.0, np.radians(45.0)


def upright_direction(
    shoulders_m: Float[np.ndarray, "poses 2 3"], ankles_m: Float[np.ndarray, "poses 2 3"]
) -> Float[np.ndarray, " 3"] | None:
    """Direction from ankles to shoulders of people who stand upright: a robust mean, of length 1.

    The joints are left and right ones of poses in any frame, NaN where unknown. Poses that lack one are left out;
    ``None`` if none has all four.
    """
    axis = shoulders_m.mean(1) - ankles_m.mean(1)
    axis = axis[np.isfinite(axis).all(-1)]
    length = np.linalg.norm(axis, axis=-1)
    if not len(length):
        return None
    unit = axis[length > _UPRIGHT * np.percentile(length, _LARGEST)]
    unit = unit / np.linalg.norm(unit, axis=-1, keepdims=True)
    up = np.median(unit, axis=0)
    for _ in range(_ITERATIONS):
        up = up / np.linalg.norm(up)
        angle = np.arccos(np.clip(unit @ up, -1.0, 1.0))
        up = (unit / (1.0 + (angle / _LEAN_RAD) ** 2)[:, None] ** 2).sum(0)
    direction: np.ndarray = up / np.linalg.norm(up)
    return direction


def turn_upright(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation that turns a direction to Z by the shortest way."""
    up = up / np.linalg.norm(up)
    axis = np.array([up[1], -up[0], 0.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.eye(3) if up[2] > 0 else np.diag([1.0, -1.0, -1.0])
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

    return Rotation.from_rotvec(np.arctan2(length, up[2]) * axis / length).as_matrix()


def turned_upright(cameras: Sequence[Camera], up: Float[np.ndarray, " 3"]) -> tuple[Camera, ...]:
    """Cameras in a world that is turned so that a direction of theirs becomes Z."""
    world_from_upright = turn_upright(up).T
    return tuple(
        replace(
            camera,
            cam_from_world=Rigid3(
                read_only(camera.cam_from_world.rotation @ world_from_upright), camera.cam_from_world.translation_m
            ),
        )
        for camera in cameras
    )


def upright_by_cameras(contents: CameraFile, otherwise: Up, note: str) -> CameraFile:
    """Turn the world of a file so that its axis nearest to the cameras' up direction becomes Z.

    Cameras that don't tell leave the axis ``otherwise``, with a note.
    """
    if not contents.cameras:
        return contents
    up, notes = up_of_cameras(contents.cameras), contents.notes
    if float(np.linalg.norm(up)) < _MIN_MEAN_UP:
        up, notes = AXES[otherwise], (*notes, note)
    axis = nearest_axis(up)
    side = "down" if axis.startswith("-") else "up"
    return replace(
        contents,
        cameras=turned_upright(contents.cameras, AXES[axis]),
        axes=f"{axis[-1]} {side}, turned to Z up",
        notes=notes,
    )


def up_of_cameras(cameras: Sequence[Camera]) -> Float[np.ndarray, " 3"]:
    """Mean of the cameras' up directions; its length is 1 if all stand alike, and near 0 if they cancel out."""
    mean: np.ndarray = np.mean([-camera.cam_from_world.rotation[1] for camera in cameras], axis=0)
    return mean


def cameras_lean_deg(cameras: Sequence[Camera]) -> float | None:
    """Angle in degrees between the cameras' up direction and Z: most cameras stand upright.

    ``None`` if the cameras do not tell: those that look straight down, or are turned by quarters, cancel out.
    """
    up = up_of_cameras(cameras)
    length = float(np.linalg.norm(up))
    return None if length < _MIN_MEAN_UP else float(np.degrees(np.arccos(np.clip(up[2] / length, -1.0, 1.0))))


def possible_up_axes(cameras: Sequence[Camera]) -> tuple[str, ...]:
    """Axes that may point up where the cameras' up directions do not tell, the likeliest first; all if none fits.

    Cameras of a rig look level or down at people, and an edge of their picture is level, as in a camera on its side.
    """
    right, down, forward = np.moveaxis(np.array([camera.cam_from_world.rotation for camera in cameras]), 1, 0)
    rising = {name: forward @ axis for name, axis in AXES.items()}
    fits = {
        name: (rising[name] < _MAX_RISE) & (np.minimum(np.abs(right @ axis), np.abs(down @ axis)) < _MAX_SLOPE)
        for name, axis in AXES.items()
    }
    in_order = sorted(AXES, key=lambda name: round(float(rising[name].mean()), 3))
    return tuple(name for name in in_order if fits[name].mean() >= _MIN_SHARE) or tuple(AXES)


def cameras_allow(cameras: Sequence[Camera], up: Float[np.ndarray, " 3"]) -> bool:
    """Agreement of cameras that another direction than Z is up.

    The rolls of cameras determine the vertical to a degree or two, because operators level them. People outweigh
    cameras that say little about a small turn, but a large one needs cameras that are wrong in the given world: people
    also lie and crawl.
    """
    against = _cost(cameras, up / np.linalg.norm(up)) - _cost(cameras, AXES["z"])
    is_large = up[2] < np.cos(_LARGE_TURN_RAD) * np.linalg.norm(up)
    return bool(against <= (-_MIN_EVIDENCE if is_large else _MIN_EVIDENCE))


def _cost(cameras: Sequence[Camera], up: Float[np.ndarray, " 3"]) -> float:
    """Negative log-likelihood of a vertical by how cameras stand, up to a constant."""
    rotations = np.array([camera.cam_from_world.rotation for camera in cameras])
    along = np.arcsin(np.clip(rotations @ up, -1.0, 1.0))  # Angles of right, down and forward above the horizon
    right, down, forward = along.T
    roll = np.minimum(np.abs(right), np.abs(down)) / _ROLL_RAD
    rise = np.maximum(forward - _LEVEL_RAD, 0.0) / _RISE_RAD
    is_turned = (np.abs(right) > np.abs(down)) | (down > 0.0)
    return float((np.minimum(roll**2 / 2, _MOST) + np.minimum(rise**2 / 2, _MOST) + _HANGS_TURNED * is_turned).sum())


def nearest_axis(direction: Float[np.ndarray, " 3"]) -> str:
    """Name of the axis that is nearest to a direction."""
    return max(AXES, key=lambda name: float(AXES[name] @ direction))
