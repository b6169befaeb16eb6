"""Checks of the world: people are upright, on the floor and of human size, and cameras are above the floor.

The usual cause of a failed check is the calibration: another up axis, another unit, an origin off the floor, a mirrored
world, or a camera that was moved after it was calibrated.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.calibration.vertical import cameras_lean_deg
from pipeline.core.data.animation import Floor
from pipeline.core.data.arrays import mean_known
from pipeline.core.data.cameras import Camera
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.findings import Finding, Severity
from pipeline.core.joints import JointSet
from pipeline.core.problems import finding_codes
from pipeline.core.problems.code_group import Code
from pipeline.export.quality.camera_shifts import CameraShift
from pipeline.geometry.camera import center_in_world
from pipeline.motion.skeleton.feet.floor import MAX_HEIGHT_M, MAX_TILT_DEG

_MAX_NAMES = 10


def first_names(names: Sequence[str]) -> str:
    """List the first ten names and the number of the others.

    >>> first_names([f"person-{k}" for k in range(1, 4)])
    'person-1, person-2, person-3'
    >>> first_names([f"cam{k}" for k in range(12)])
    'cam0, cam1, cam2, cam3, cam4, cam5, cam6, cam7, cam8, cam9 and 2 more'
    """
    more = len(names) - _MAX_NAMES
    listed = ", ".join(names[:_MAX_NAMES])
    return f"{listed} and {more} more" if more > 0 else listed


# Limit on the median angle from upright: people stand, walk or sit most of the time.
MAX_LEAN_DEG = 45.0
STATURE_RANGE_M = (1.0, 2.3)

_LEVEL = "Level the calibration: `refine_calibration` does it if people walk all over the place."
_STATE_UP = "check which axis points up; state it by `up` if it is not Z."
_HEAD = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
_ANKLES = ("left_ankle", "right_ankle")


# A world counts as mirrored if left and right are exchanged in at least this share of so many frames.
MIRRORED_SHARE, MIRRORED_FRAMES = 0.75, 20
# Cosine below which left and right are not known. Nine in ten people of good sessions have more.
_MIN_LEFTNESS = 0.3

# Failed checks with which the result is empty or wrong; with others it may be.
_ERRORS = frozenset({"nobody_found", "upside_down", "mirrored_world"})

_Failed = dict[str, Any]


def failed_check(
    code: Code,
    message: str,
    evidence: Mapping[str, Any] | None = None,
    camera: str | None = None,
    hint: str | None = None,
) -> _Failed:
    """Finding of a failed check of a take, as ``metrics.json`` lists it."""
    severity: Severity = "info" if code == finding_codes.CALIBRATION_KEPT else "error" if code in _ERRORS else "warning"
    return Finding(code, message, camera, severity, hint, evidence or {}).to_json()


def _points_m(track: Track3D, joints: JointSet, names: Sequence[str]) -> Float[np.ndarray, "frames joints 3"]:
    return track.xyz_m[:, joints.indices(tuple(name for name in names if name in joints.names))]


def feet_to_head_m(track: Track3D, joints: JointSet) -> Float[np.ndarray, "frames 3"]:
    """Vector in metres from the ankles to the head in each frame; NaN if one of them is unknown."""
    head_m, ankles_m = (mean_known(_points_m(track, joints, names), 1) for names in (_HEAD, _ANKLES))
    return head_m - ankles_m


def _floor_m(tracks: Sequence[Track3D], joints: JointSet, floor: Floor | None) -> float:
    """Height of the floor under the middle of the feet; NaN if unknown."""
    places_m = np.concatenate(
        [np.zeros((0, 2)), *(_points_m(track, joints, _ANKLES)[..., :2].reshape(-1, 2) for track in tracks)]
    )
    places_m = places_m[np.isfinite(places_m).all(-1)]
    if floor is None or not len(places_m):
        return np.nan
    x_m, y_m = np.median(places_m, axis=0)
    return floor.z_m + floor.slope_x * float(x_m) + floor.slope_y * float(y_m)


def world_checks(
    reconstruction: Reconstruction, statures_m: Mapping[int, float], shifted: Sequence[CameraShift]
) -> list[dict[str, Any]]:
    """List the failed checks of the world as findings.

    Statures are by track, NaN where unknown; ``shifted`` are the cameras that ``find_shifted`` finds.
    """
    tracks, joints, accepts = reconstruction.tracks, reconstruction.joints, reconstruction.accepts
    floor = reconstruction.animation.floor
    floor_m = _floor_m(tracks, joints, floor)
    lowest_m, highest_m = STATURE_RANGE_M
    odd_m = {
        number: stature_m
        for number, stature_m in statures_m.items()
        if (stature_m < lowest_m or stature_m > highest_m) and not accepts(finding_codes.STATURE_OUT_OF_RANGE, number)
    }
    cameras, below = reconstruction.cameras, finding_codes.CAMERA_BELOW_FLOOR
    checks = (
        _check_upright(cameras, tracks, joints),
        _check_floor(floor, floor_m),
        _check_statures(odd_m),
        _check_cameras([camera for camera in cameras if not accepts(below, camera=camera.name)], floor_m),
        _check_handedness(tracks, joints),
        _check_shifts(cameras, shifted),
    )
    return [finding for some in checks for finding in some if not accepts(finding["code"], camera=finding["camera"])]


@dataclass(frozen=True, slots=True)
class LeanFault:
    """Reason why people are not upright in the world."""

    code: Code
    message: str
    hint: str
    is_agreed: bool  # True if the cameras are tilted as the people are, so that the world must be


def lean_fault(lean_deg: float, cameras: Sequence[Camera], when: str = "") -> LeanFault | None:
    """Judge the angle of people from Z by the angle of the cameras; ``None`` if people are upright.

    Most cameras stand upright, while people also lie, crawl and stand on their hands. ``when`` says in a sentence at
    which instants people lean.
    """
    if lean_deg <= MAX_LEAN_DEG:
        return None
    cameras_deg = cameras_lean_deg(cameras)
    is_down, is_camera_upright = lean_deg > 180.0 - MAX_LEAN_DEG, cameras_deg is not None and cameras_deg < MAX_LEAN_DEG
    is_agreed = not is_camera_upright and cameras_deg is not None and abs(cameras_deg - lean_deg) < MAX_LEAN_DEG
    if is_camera_upright:
        pose = "are upside down" if is_down else "lie or crawl"
        message = (
            f"People lean {lean_deg:.0f} degrees{when}, and the cameras are upright: people {pose}, or the "
            "calibration's up axis is not Z."
        )
        return LeanFault(finding_codes.NOT_UPRIGHT, message, f"If people stand, {_STATE_UP}", is_agreed)
    if is_down:
        message = "Heads are below feet: the calibration's Z axis points down."
        return LeanFault(
            finding_codes.UPSIDE_DOWN, message, "Turn the calibration: state by `up` which axis points up.", is_agreed
        )
    message = f"People lean {lean_deg:.0f} degrees{when}: the calibration's up axis may not be Z."
    return LeanFault(
        finding_codes.NOT_UPRIGHT, message, "Check which axis points up; state it by `up` if it is not Z.", is_agreed
    )


def _check_upright(cameras: Sequence[Camera], tracks: Sequence[Track3D], joints: JointSet) -> Iterator[_Failed]:
    upwards = np.concatenate([np.zeros((0, 3)), *(feet_to_head_m(track, joints) for track in tracks)])
    upwards = upwards[np.isfinite(upwards).all(-1)]
    if len(upwards) == 0:
        return
    lean_deg = float(np.median(np.degrees(np.arctan2(np.hypot(upwards[:, 0], upwards[:, 1]), upwards[:, 2]))))
    if (fault := lean_fault(lean_deg, cameras, " in most frames")) is not None:
        yield failed_check(fault.code, fault.message, {"lean_deg": round(lean_deg, 3)}, hint=fault.hint)


def _check_floor(floor: Floor | None, floor_m: float) -> Iterator[_Failed]:
    if abs(floor_m) > MAX_HEIGHT_M:
        message = f"Feet stand at a height of {floor_m:.2f} m, not on the floor at 0."
        hint = f"Move the calibration's origin by {floor_m:.2f} m along Z, or level it (`refine_calibration`)."
        yield failed_check(finding_codes.FLOOR_NOT_AT_ZERO, message, {"height_m": round(floor_m, 3)}, hint=hint)
    if floor is not None and floor.tilt_deg > MAX_TILT_DEG:
        message = f"The floor that feet stand on is tilted by {floor.tilt_deg:.1f} degrees."
        yield failed_check(finding_codes.FLOOR_TILTED, message, {"tilt_deg": round(floor.tilt_deg, 3)}, hint=_LEVEL)


def _check_statures(odd_m: Mapping[int, float]) -> Iterator[_Failed]:
    if not odd_m:
        return
    lowest_m, highest_m = STATURE_RANGE_M
    middle_m = float(np.median(list(odd_m.values())))
    if len(odd_m) == 1:
        ((number, stature_m),) = odd_m.items()
        message = f"person-{number} is {stature_m:.2f} m tall: the unit of the calibration may not be the metre."
    else:
        people = first_names([f"person-{number} ({stature_m:.2f} m)" for number, stature_m in odd_m.items()])
        message = (
            f"{len(odd_m)} people are not {lowest_m:g} to {highest_m:g} m tall: {people}. The unit of the calibration "
            "may not be the metre."
        )
    of_people = [{"person": number, "stature_m": round(stature_m, 3)} for number, stature_m in odd_m.items()]
    evidence = {"stature_m": round(middle_m, 3), "people": of_people}
    yield failed_check(finding_codes.STATURE_OUT_OF_RANGE, message, evidence, hint=hint_of_unit(middle_m))


def hint_of_unit(stature_m: float) -> str:
    """Guess the unit in which a person would have a human stature."""
    lowest_m, highest_m = STATURE_RANGE_M
    for name, unit_m in (("cm", 0.01), ("mm", 0.001)):
        if lowest_m <= stature_m * unit_m <= highest_m:
            return f"The lengths look like {name}: state the unit (`units`)."
    return "Check the calibration's unit."


def _check_cameras(cameras: Sequence[Camera], floor_m: float) -> Iterator[_Failed]:
    lowest_m = (floor_m if np.isfinite(floor_m) else 0.0) - MAX_HEIGHT_M
    heights_m = {camera.name: float(center_in_world(camera)[2]) for camera in cameras}
    below = [name for name, height_m in heights_m.items() if height_m < lowest_m]
    if below:
        lowest = min(below, key=lambda name: heights_m[name])
        message = f"Cameras are below the floor: {first_names(below)}."
        evidence, hint = {"height_m": round(heights_m[lowest], 3)}, "Check the calibration's axes."
        yield failed_check(finding_codes.CAMERA_BELOW_FLOOR, message, evidence, lowest, hint)


def _check_handedness(tracks: Sequence[Track3D], joints: JointSet) -> Iterator[_Failed]:
    """Compare people's left with the left that follows from the front and the top of their heads and trunks."""
    sides = [np.zeros(0), *(leftness(track, joints) for track in tracks)]
    sign = np.concatenate(sides)
    sign = sign[np.isfinite(sign)]
    share = float(np.mean(sign < 0.0)) if len(sign) else 0.0
    if len(sign) >= MIRRORED_FRAMES and share >= MIRRORED_SHARE:
        yield failed_check(
            finding_codes.MIRRORED_WORLD,
            f"People's left and right are exchanged in {100 * share:.0f} % of the frames: the world is mirrored.",
            {"share": round(share, 3)},
            hint="Check whether an axis of the calibration has the wrong sign, or the videos are mirrored.",
        )


def leftness(track: Track3D, joints: JointSet) -> Float[np.ndarray, " frames"]:
    """Cosine of the left shoulder to the left of the face: positive in a true world; NaN if unknown.

    It is unknown, too, of people without a front: pictures of people are flat, and so are people whose front is noise.
    """
    needed = ("nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if not set(needed) <= set(joints.names):
        return np.zeros(0)
    nose, left_ear, right_ear, left, right, left_hip, right_hip = np.moveaxis(_points_m(track, joints, needed), 1, 0)
    front = nose - (left_ear + right_ear) / 2
    top = (left + right - left_hip - right_hip) / 2
    extents = [np.linalg.norm(vector, axis=-1) for vector in (top, front, left - right)]
    cosine = np.asarray((np.cross(top, front) * (left - right)).sum(-1)) / np.maximum(np.prod(extents, axis=0), 1e-12)
    return np.where(np.abs(cosine) >= _MIN_LEFTNESS, cosine, np.nan)


def _check_shifts(cameras: Sequence[Camera], shifted: Sequence[CameraShift]) -> Iterator[_Failed]:
    for shift in shifted:
        name = cameras[shift.camera].name
        yield failed_check(
            finding_codes.CAMERA_DISAGREES,
            f"{name}: {shift.message}",
            {"shift_px": round(shift.shift_px, 3)},
            name,
            "Refine the calibration (`refine_calibration`), calibrate the camera again, or check its offset.",
        )
