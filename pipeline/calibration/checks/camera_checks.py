"""Check the cameras of a calibration against each other and against what lenses and rigs can be."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.checks.places import check_places
from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import CERTAIN, Finding, Severity
from pipeline.core.problems import finding_codes
from pipeline.geometry.camera import center_in_world, project, rays_in_world, twelve_coefficients
from pipeline.geometry.fisheye import MAX_ANGLE_RAD, angle_limit_rad, radius

# Angle of view along the longer side of the picture.
_ANGLE_RANGE_DEG = (3.0, 140.0)
_MAX_FISHEYE_DEG = 250.0
# Distance of the principal point from the middle, as a share of the side.
_MAX_OFF_CENTER = 0.25
# Difference of the focal lengths along x and y: pixels of today's cameras are square.
_MAX_ASPECT = 0.03
# Radii of the ideal image that are tried, in radii of the picture's corner, and their number.
_FAR, _NUM_RADII = 20.0, 20_000


def check_lens(camera: Camera) -> Iterator[Finding]:
    """Check a lens at the size of the picture; nothing is found if the size is not known."""
    if camera.size_px == UNKNOWN_SIZE:
        return
    yield from _check_focal_length(camera)
    yield from _check_principal_point(camera)
    yield from _check_distortion(camera)


def _check_focal_length(camera: Camera) -> Iterator[Finding]:
    focal_px = camera.matrix.diagonal()[:2]
    half = max(camera.size_px) / 2 / float(focal_px[int(np.argmax(camera.size_px))])
    is_fisheye = camera.lens == "fisheye"
    angle_deg = 2 * float(np.degrees(half if is_fisheye else np.arctan(half)))
    lowest_deg, highest_deg = _ANGLE_RANGE_DEG[0], _MAX_FISHEYE_DEG if is_fisheye else _ANGLE_RANGE_DEG[1]
    width, height = camera.size_px
    if not lowest_deg <= angle_deg <= highest_deg:
        message = (
            f"A focal length of {focal_px[0]:.0f} px at {width} x {height} pixels is an angle of view of "
            f"{angle_deg:.3g} degrees."
        )
        hint = "Check that the camera matrix belongs to this size of the picture, in pixels."
        yield Finding(finding_codes.FOCAL_LENGTH, message, camera.name, "warning", hint, {"angle_deg": angle_deg})
    aspect = float(focal_px[1] / focal_px[0])
    if abs(np.log(aspect)) > _MAX_ASPECT:
        message = f"The focal lengths along x and y, {focal_px[0]:.0f} and {focal_px[1]:.0f} px, differ."
        hint = "Check the camera matrix: pixels are square, unless the picture was stretched."
        yield Finding(finding_codes.PIXELS_NOT_SQUARE, message, camera.name, "warning", hint, {"aspect": aspect})


def _check_principal_point(camera: Camera) -> Iterator[Finding]:
    size_px = np.array(camera.size_px)
    point_px = camera.matrix[:2, 2]
    share = float(np.abs(point_px / size_px - 0.5).max())
    if share > _MAX_OFF_CENTER:
        message = (
            f"The principal point, ({point_px[0]:.0f}, {point_px[1]:.0f}) px, is far from the middle of the picture, "
            f"({size_px[0] / 2:.0f}, {size_px[1] / 2:.0f}) px."
        )
        hint = "Check that the camera matrix belongs to this size of the picture, and that the picture was not cropped."
        yield Finding(finding_codes.PRINCIPAL_POINT, message, camera.name, "warning", hint, {"share": share})


def _check_distortion(camera: Camera) -> Iterator[Finding]:
    """Find a lens whose picture folds back: two directions there have the same pixel."""
    corner, inner = picture_radii(camera)
    limit, _ = growing_radius(camera)
    if limit >= corner:
        return
    share = limit / corner
    message = (
        f"The distortion folds the picture: beyond {100 * share:.0f} % of the way from the principal point to the "
        "corner it has no inverse."
    )
    hint = "Calibrate the lens again with views of the board near the edges, or with fewer coefficients."
    yield Finding(
        finding_codes.DISTORTION_FOLDS,
        message,
        camera.name,
        "error" if limit < inner else "warning",
        hint,
        {"share": share},
    )


def picture_radii(camera: Camera) -> tuple[float, float]:
    """Distances of the farthest corner and of the nearest edge from the principal point, on the plane z = 1."""
    width, height = camera.size_px
    inverse = np.linalg.inv(camera.matrix)
    corners_px = np.array([[x, y, 1.0] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
    corners = (corners_px @ inverse.T)[:, :2]
    edges = np.abs(corners[[0, 0, 3, 3], [0, 1, 0, 1]])
    return float(np.linalg.norm(corners, axis=-1).max()), float(edges.min())


def growing_radius(camera: Camera) -> tuple[float, float]:
    """Radius up to which the lens's radial distortion grows: on the picture, and on the ideal image.

    Beyond it, and beyond the angle limit of a fisheye lens, there is no inverse. Both are infinite if it always grows.
    """
    if camera.lens == "fisheye":
        limit_rad = angle_limit_rad(camera.distortion)
        # Beyond MAX_ANGLE_RAD a fisheye is left out by us, and is not at fault.
        on_picture = float(radius(np.array([limit_rad]), camera.distortion)[0])
        return (np.inf if limit_rad == MAX_ANGLE_RAD else on_picture), float(np.tan(limit_rad))
    corner, _ = picture_radii(camera)
    ideal = np.linspace(0.0, _FAR * corner, _NUM_RADII)
    seen = _radial(ideal, camera.distortion)
    is_growing = np.isfinite(seen[1:]) & (np.diff(seen) > 0.0)
    if is_growing.all():
        return np.inf, np.inf
    last = int(np.argmin(is_growing))
    return float(seen[last]), float(ideal[last])


def _radial(
    ideal: Float[np.ndarray, " radii"], distortion: Float[np.ndarray, " coefficients"]
) -> Float[np.ndarray, " radii"]:
    """Radii on the picture by the radial part of the standard model."""
    k1, k2, _, _, k3, k4, k5, k6, *_ = twelve_coefficients(distortion)
    r2 = ideal * ideal
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.asarray(ideal * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6))))


MIN_CAMERAS = 2
# Places in the view of a camera: a grid on the picture, and distances at which people are, up to thirty times the
# extent of the rig: cameras with long lenses side by side share a view far away only.
_GRID = (9, 7)
_NEAREST_M, _FARTHEST_M, _FARTHEST = 0.5, 10.0, 30.0
_NUM_DISTANCES = 100


def check_cameras(cameras: Sequence[Camera]) -> list[Finding]:
    """Check a calibration without any picture.

    ``cameras``: cameras of a file or of a session, in metres. Lenses are checked at the size of the picture, where it
    is known. Returns findings about lenses, places, the unit, the up axis and common views; empty if nothing is wrong.
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
    """Errors with which no person can be located, whatever the pictures show."""
    alone = [*_check_number(cameras), *check_places(cameras)]
    return [finding for finding in alone if finding.severity == "error" and finding.code in CERTAIN]


def _check_number(cameras: Sequence[Camera]) -> list[Finding]:
    if len(cameras) >= MIN_CAMERAS:
        return []
    message = f"The calibration has {len(cameras)} camera{'s' * (len(cameras) != 1)}: no person can be located."
    hint = "Give a calibration of at least two cameras."
    return [Finding(finding_codes.TOO_FEW_CAMERAS, message, None, "error", hint, {"num_cameras": len(cameras)})]


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
        if others and not any(in_picture(cameras[other], places_m).any() for other in others):
            alone.append(camera.name)
    message = "No other camera sees any place that the camera sees: people there can't be located."
    hint = "Check the camera's pose and the axes of the calibration, or turn the camera to the others' view."
    # Without this camera the others can do.
    severity: Severity = "error" if len(alone) == len(cameras) else "warning"
    return [Finding(finding_codes.NO_COMMON_VIEW, message, name, severity, hint) for name in alone]


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
    return places_m[in_picture(camera, places_m)]


def in_picture(camera: Camera, places_m: Float[np.ndarray, "places 3"]) -> Bool[np.ndarray, " places"]:
    """Places that a camera has in its picture. The size of its picture must be known; the places are in the world."""
    _, limit = growing_radius(camera)
    in_cam = camera.cam_from_world.apply(places_m)
    is_ahead = in_cam[:, 2] > 0.0
    # Beyond the limit, distortion would bring places back into the picture.
    is_within = is_ahead & (np.linalg.norm(in_cam[:, :2], axis=-1) <= limit * np.where(is_ahead, in_cam[:, 2], 1.0))
    points_px = np.where(is_within[:, None], project(camera, places_m), np.nan)
    with np.errstate(invalid="ignore"):
        return np.asarray(((points_px > -0.5) & (points_px < np.array(camera.size_px) - 0.5)).all(-1))
