"""Check the cameras of a calibration against each other and against what lenses and rigs can be."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.checks.lenses import check_lens, growing_radius
from pipeline.calibration.checks.places import check_places
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import CERTAIN, Finding, Severity
from pipeline.core.problems.findings import NO_COMMON_VIEW, TOO_FEW_CAMERAS
from pipeline.geometry.camera import center_in_world, project, rays_in_world

MIN_CAMERAS = 2
# Places in the view of a camera: a grid on the picture, and distances at which people are, up to thirty times the
# extent of the rig: cameras with long lenses side by side share a view far away only.
_GRID = (9, 7)
_NEAREST_M, _FARTHEST_M, _FARTHEST = 0.5, 10.0, 30.0
_NUM_DISTANCES = 100


def check_cameras(cameras: Sequence[Camera]) -> list[Finding]:
    """Check a calibration without any picture.

    Parameters
    ----------
    cameras
        Cameras of a file or of a session, in metres. Lenses are checked at the size of the picture, where it is known.

    Returns
    -------
        Findings about lenses, places, the unit, the up axis and common views; empty if nothing is wrong.
    """
    findings = [*_check_number(cameras), *check_places(cameras)]
    for camera in cameras:
        findings += check_lens(camera)
    # Cameras of another unit, or without poses, see no common place because of that.
    is_placed = not any(finding.code in {"calibration_unposed", "world_unit"} for finding in findings)
    if is_placed and all(camera.size_px != UNKNOWN_SIZE for camera in cameras):
        findings += check_views(cameras)
    return findings


def certain_errors(cameras: Sequence[Camera]) -> list[Finding]:
    """Errors with which nobody can be located, whatever the pictures show."""
    alone = [*_check_number(cameras), *check_places(cameras)]
    return [finding for finding in alone if finding.severity == "error" and finding.code in CERTAIN]


def _check_number(cameras: Sequence[Camera]) -> list[Finding]:
    if len(cameras) >= MIN_CAMERAS:
        return []
    message = f"The calibration has {len(cameras)} camera{'s' * (len(cameras) != 1)}: nobody can be located."
    hint = "Give a calibration of at least two cameras."
    return [Finding(TOO_FEW_CAMERAS, message, None, "error", hint, {"num_cameras": len(cameras)})]


def check_views(cameras: Sequence[Camera]) -> list[Finding]:
    """Find cameras whose view no other camera shares: people there can't be located.

    The sizes of the cameras' pictures must be known.
    """
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    apart_m = np.linalg.norm(centers_m[:, None] - centers_m[None], axis=-1)
    alone = []
    for number, camera in enumerate(cameras):
        places_m = _places_m(camera, float(apart_m.max()))
        # Neighbours first: they share most.
        others = [other for other in np.argsort(apart_m[number], kind="stable") if other != number]
        if others and not any(sees(cameras[other], places_m).any() for other in others):
            alone.append(camera.name)
    message = "No other camera sees any place that the camera sees: people there can't be located."
    hint = "Check the camera's pose and the axes of the calibration, or turn the camera to the others' view."
    # Without this camera the others can do.
    severity: Severity = "error" if len(alone) == len(cameras) else "warning"
    return [Finding(NO_COMMON_VIEW, message, name, severity, hint) for name in alone]


def _places_m(camera: Camera, extent_m: float) -> Float[np.ndarray, "places 3"]:
    """Places that a camera sees, from half a metre to thirty times the extent of the rig away."""
    columns, rows = (np.linspace(0.0, side - 1.0, count) for side, count in zip(camera.size_px, _GRID, strict=True))
    grid_px = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    if not camera.is_ideal:
        from pipeline.geometry.undistortion import undistort_px  # noqa: PLC0415 - loads numba

        grid_px = undistort_px(camera, grid_px)
    rays = rays_in_world(camera, grid_px[np.isfinite(grid_px).all(-1)])
    distance_m = np.geomspace(_NEAREST_M, max(_FARTHEST_M, _FARTHEST * extent_m), _NUM_DISTANCES)
    places_m = (center_in_world(camera) + distance_m[:, None, None] * rays).reshape(-1, 3)
    return places_m[sees(camera, places_m)]


def sees(camera: Camera, places_m: Float[np.ndarray, "places 3"]) -> Bool[np.ndarray, " places"]:
    """Places that a camera has in its picture.

    The size of its picture must be known; the places are in the world.
    """
    _, limit = growing_radius(camera)
    in_cam = camera.cam_from_world.apply(places_m)
    is_ahead = in_cam[:, 2] > 0.0
    # Beyond the limit, distortion would bring places back into the picture.
    is_within = is_ahead & (np.linalg.norm(in_cam[:, :2], axis=-1) <= limit * np.where(is_ahead, in_cam[:, 2], 1.0))
    points_px = np.where(is_within[:, None], project(camera, places_m), np.nan)
    with np.errstate(invalid="ignore"):
        return np.asarray(((points_px > -0.5) & (points_px < np.array(camera.size_px) - 0.5)).all(-1))
