"""Checks of one camera's lens: focal length, principal point, and distortion inside the picture."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Finding
from pipeline.core.problems.findings import DISTORTION_FOLDS, FOCAL_LENGTH, PIXELS_NOT_SQUARE, PRINCIPAL_POINT
from pipeline.geometry.camera import twelve_coefficients
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
        yield Finding(FOCAL_LENGTH, message, camera.name, "warning", hint, {"angle_deg": angle_deg})
    aspect = float(focal_px[1] / focal_px[0])
    if abs(np.log(aspect)) > _MAX_ASPECT:
        message = f"The focal lengths along x and y, {focal_px[0]:.0f} and {focal_px[1]:.0f} px, differ."
        hint = "Check the camera matrix: pixels are square, unless the picture was stretched."
        yield Finding(PIXELS_NOT_SQUARE, message, camera.name, "warning", hint, {"aspect": aspect})


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
        yield Finding(PRINCIPAL_POINT, message, camera.name, "warning", hint, {"share": share})


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
        DISTORTION_FOLDS, message, camera.name, "error" if limit < inner else "warning", hint, {"share": share}
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
