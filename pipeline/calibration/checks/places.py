"""Checks of the cameras' places: the unit, the up axis, cameras below the floor, and cameras at the same place."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.calibration.vertical import AXES, cameras_lean_deg, nearest_axis, possible_up_axes, up_of_cameras
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Finding, Severity
from pipeline.core.options.job_choices import UNITS_M
from pipeline.core.problems import finding_codes
from pipeline.core.problems.request_codes import CALIBRATION_UNPOSED
from pipeline.geometry.camera import center_in_world

UP_AXIS_CODES = (finding_codes.UPSIDE_DOWN, finding_codes.NOT_UPRIGHT, finding_codes.UP_AXIS_UNKNOWN)
"""Codes of findings about the axis that points up."""

# Distance in metres of the cameras that are farthest apart, in rigs for people, and in any rig that sees people.
_EXTENT_RANGE_M = (0.05, 300.0)
_POSSIBLE_EXTENT_M = (0.01, 1000.0)
# Extent of a usual rig, by which a unit is guessed.
_USUAL_EXTENT_M = 6.0
_SAME_PLACE_M, _SAME_TURN_DEG = 0.01, 1.0
# Depth below z = 0 at which a camera must be below the floor.
_MAX_DEPTH_M = 0.15
# Largest angle of the cameras' up direction from Z at which Z counts as up.
_MAX_ANGLE_DEG = 45.0
_STATE = "state the axis that does (`--up={0}`, `up`), or turn the file (`multicap calibration convert`)."
_TURN = f"Z must point up: {_STATE}"
_CHOOSE = f"If Z does not point up, {_STATE}"


def check_places(cameras: Sequence[Camera]) -> list[Finding]:
    """Check where cameras are and how they are turned."""
    if len(cameras) < 2:
        return []
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    apart_m = np.linalg.norm(centers_m[:, None] - centers_m[None], axis=-1)
    turn_deg = _turns_deg(cameras)
    if (apart_m < _SAME_PLACE_M).all() and (turn_deg < _SAME_TURN_DEG).all():
        message = "All cameras have the same pose: the calibration has intrinsics only."
        hint = "Calibrate the poses: film a board, or people, with all cameras at the same time."
        return [Finding(CALIBRATION_UNPOSED, message, None, "error", hint)]
    wrong_world = [*_unit(float(apart_m.max())), *_up_axis(cameras)]
    # Heights mean nothing in another unit, or along another axis.
    return [*_same_places(cameras, apart_m, turn_deg), *(wrong_world or _below_floor(cameras, centers_m))]


def _turns_deg(cameras: Sequence[Camera]) -> Float[np.ndarray, "cameras cameras"]:
    """Angles in degrees between the orientations of cameras."""
    rotation = np.array([camera.cam_from_world.rotation for camera in cameras])
    cosine = (np.einsum("aij,bij->ab", rotation, rotation) - 1.0) / 2.0
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _same_places(
    cameras: Sequence[Camera],
    apart_m: Float[np.ndarray, "cameras cameras"],
    turn_deg: Float[np.ndarray, "cameras cameras"],
) -> Iterator[Finding]:
    """Find cameras at the place of an earlier camera: one finding a camera."""
    for later, camera in enumerate(cameras):
        near = np.flatnonzero(apart_m[later, :later] < _SAME_PLACE_M)
        if not len(near):
            continue
        first = int(near[0])
        evidence = {"distance_m": float(apart_m[later, first]), "other_camera": cameras[first].name}
        if turn_deg[later, first] < _SAME_TURN_DEG:
            message = f"The camera has the same pose as {cameras[first].name}."
            hint = "Check whether one camera stands twice in the file."
            yield Finding(finding_codes.SAME_PLACE, message, camera.name, "error", hint, evidence)
        else:
            message = f"The camera is at the same place as {cameras[first].name}: these two alone can't locate people."
            hint = "Check the positions, or let other cameras see the same people."
            yield Finding(finding_codes.SAME_PLACE, message, camera.name, "warning", hint, evidence)


def _unit(extent_m: float) -> Iterator[Finding]:
    lowest_m, highest_m = _EXTENT_RANGE_M
    if lowest_m <= extent_m <= highest_m:
        return
    message = f"The cameras are up to {extent_m:,.3g} m apart: the unit of the calibration may not be the metre."
    is_possible = _POSSIBLE_EXTENT_M[0] <= extent_m <= _POSSIBLE_EXTENT_M[1]
    severity: Severity = "warning" if is_possible else "error"
    yield Finding(finding_codes.WORLD_UNIT, message, None, severity, _hint_of_unit(extent_m), {"extent_m": extent_m})


def _hint_of_unit(extent_m: float) -> str:
    """Guess the unit in which the cameras would be as far apart as in a usual rig."""
    in_range = {
        unit: extent_m * metres
        for unit, metres in UNITS_M.items()
        if unit != "m" and _EXTENT_RANGE_M[0] <= extent_m * metres <= _EXTENT_RANGE_M[1]
    }
    if not in_range:
        return "Check the unit of the calibration, and the unit that was stated (`--units`, `units`)."
    unit = min(in_range, key=lambda name: abs(np.log(in_range[name] / _USUAL_EXTENT_M)))
    return f"The lengths look like {unit}: state the unit (`--units {unit}`, `units`)."


def _up_axis(cameras: Sequence[Camera]) -> Iterator[Finding]:
    """Compare the mean of the cameras' up directions with Z: most cameras stand upright.

    Where they do not tell, the axes that may point up are named, unless it can only be Z.
    """
    up, angle_deg = up_of_cameras(cameras), cameras_lean_deg(cameras)
    if angle_deg is None:
        if (axes := possible_up_axes(cameras)) != ("z",):
            names = " or ".join(axis.upper() for axis in axes)
            message = f"The cameras do not tell which axis points up: {names}. Z is taken."
            severity: Severity = "info" if "z" in axes else "warning"
            other = next(axis for axis in axes if axis != "z")
            yield Finding(
                finding_codes.UP_AXIS_UNKNOWN, message, None, severity, _CHOOSE.format(other), {"up_axes": list(axes)}
            )
    elif angle_deg > 180.0 - _MAX_ANGLE_DEG:
        message = "The cameras are upside down: the calibration's Z axis points down."
        yield Finding(
            finding_codes.UPSIDE_DOWN,
            message,
            None,
            "error",
            _TURN.format("-z"),
            {"angle_deg": angle_deg, "up_axis": "-z"},
        )
    elif angle_deg > _MAX_ANGLE_DEG:
        axis = nearest_axis(up)
        near_deg = float(np.degrees(np.arccos(np.clip(AXES[axis] @ up / np.linalg.norm(up), -1.0, 1.0))))
        message = (
            f"The cameras' up direction is {angle_deg:.0f} degrees from Z and {near_deg:.0f} degrees from "
            f"{axis.upper()}: the calibration's up axis may be {axis.upper()}."
        )
        evidence = {"angle_deg": angle_deg, "up_axis": axis}
        yield Finding(finding_codes.NOT_UPRIGHT, message, None, "warning", _TURN.format(axis), evidence)


def _below_floor(cameras: Sequence[Camera], centers_m: Float[np.ndarray, "cameras 3"]) -> list[Finding]:
    hint = "Check the calibration's axes and origin: the floor is z = 0."
    return [
        Finding(
            finding_codes.CAMERA_BELOW_FLOOR,
            f"The camera is {-height_m:.2f} m below z = 0.",
            camera.name,
            "warning",
            hint,
            {"height_m": height_m},
        )
        for camera, height_m in zip(cameras, centers_m[:, 2].tolist(), strict=True)
        if height_m < -_MAX_DEPTH_M
    ]
