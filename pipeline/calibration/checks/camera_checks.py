"""Check the cameras of a calibration against each other, their places, and what lenses and rigs can be."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.vertical import AXES, cameras_lean_deg, nearest_axis, possible_up_axes, up_of_cameras
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import CERTAIN, Finding, Severity
from pipeline.core.options.job_choices import UNITS_M
from pipeline.core.problems import finding_codes
from pipeline.core.problems.request_codes import CALIBRATION_UNPOSED
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
