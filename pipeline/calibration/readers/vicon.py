"""Vicon calibration (``.xcp``): the video cameras, in their first key frame.

Lengths are millimetres; ORIENTATION is the quaternion (x, y, z, w) from world to camera, POSITION the camera's centre.
``VICON_RADIAL`` (k1, k2) and the newer ``VICON_RADIAL2`` (``Vicon3Parameter``, centre, k1, k2, k3) map distorted to
ideal pixels: ``ideal = c + (seen - c) (1 + k1 r^2 + k2 r^4 + k3 r^6)``, r in pixels. OpenCV's model has the other
direction, so its coefficients are fitted.

Rows of the table of formats:

| Vicon | `.xcp`, root element `Cameras` | mm | Z up; video cameras alone (`SYSTEM` is `DV`, or `TYPE` has
`video`), named by `DEVICEID` or `NAME` |
"""

from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.formats import reader
from pipeline.calibration.readers.fields import quaternion_matrix
from pipeline.calibration.readers.xml_files import NUMBER, read_root, video_cameras
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.parsing import FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX, SIDE_PX, Quantity, UnreadableError
from pipeline.core.problems.session_codes import INVALID_NUMBER, INVALID_ROTATION, UNSUPPORTED_LENS

_ASPECT = Quantity(0.01, 100, "")
# Coefficients in pixels are about 1e-8, 1e-15 and 1e-22.
RADIAL = Quantity(-1e-4, 1e-4, "")
_MODEL = "Vicon3Parameter"
_NUM_SAMPLES = 25
# Largest distance of a point by OpenCV's coefficients from its place, by their number. Wide lenses of Vue cameras show
# their corners at 0.6 of the ideal radius; five coefficients are off by 13 pixels there, eight by a twentieth of one.
_MAX_RESIDUAL_PX = {5: 0.05, 8: 0.5}
_MIN_GROWTH = 0.05
_FAR_PX = 1e6


@reader("Vicon", suffixes=(".xcp",), roots=("Cameras",))
def read(content: bytes, file: str) -> CameraFile:
    """Read the video cameras of an XCP file, or all cameras if none is one; ``InputError`` lists all problems."""
    root = read_root(content, file)
    elements = [element for element in root.iterfind("./Camera") if element.find("./KeyFrames/KeyFrame") is not None]
    reading = Reading(file)
    videos = video_cameras(elements, _films_video, "DEVICEID", reading)
    # One camera above the limit suffices to report that there are too many.
    raw = [_raw(element, reading) for element in islice(videos or elements, MAX_CAMERAS + 1)]
    return reading.contents("Vicon XCP", raw, "mm", axes="Z up, as Vicon calibrates")


def _films_video(element: Any) -> bool:
    return element.get("SYSTEM") == "DV" or "video" in element.get("TYPE", "").lower()


def _raw(element: Any, reading: Reading) -> RawCamera:
    name, frame = element.get("DEVICEID"), element.find("./KeyFrames/KeyFrame")

    def numbers(source: Any, attribute: str, count: int, allowed: Quantity = NUMBER) -> np.ndarray:
        values = _floats(source.get(attribute, ""))
        if values.shape == (count,) and allowed.holds(values):
            return values
        message = f"The attribute {attribute} must be {count} numbers, each {allowed}."
        reading.complain(INVALID_NUMBER, message, name, attribute)
        # Finite numbers, so that the problem is reported only once.
        return np.ones(count)

    size_px = numbers(element, "SENSOR_SIZE", 2, SIDE_PX)
    focal_px = numbers(frame, "FOCAL_LENGTH", 1, FOCAL_LENGTH_PX)[0]
    aspect = numbers(element, "PIXEL_ASPECT_RATIO", 1, _ASPECT)[0] if element.get("PIXEL_ASPECT_RATIO") else 1.0
    centre_px = numbers(frame, "PRINCIPAL_POINT", 2, PRINCIPAL_POINT_PX)
    try:
        rotation = quaternion_matrix(numbers(frame, "ORIENTATION", 4))
    except UnreadableError:
        message = "The attribute ORIENTATION is not a rotation."
        reading.complain(INVALID_ROTATION, message, name, "ORIENTATION")
        rotation = np.eye(3)
    matrix = np.array([[focal_px, 0.0, centre_px[0]], [0.0, focal_px / aspect, centre_px[1]], [0.0, 0.0, 1.0]])
    lens = _lens(frame, centre_px)
    distortion = None if lens is None else fitted(*lens, size_px, matrix)
    if distortion is None:
        message = "The lens model is not Vicon's radial one, or its coefficients are not plausible."
        reading.complain(UNSUPPORTED_LENS, message, name, "VICON_RADIAL2")
        distortion = np.zeros(5)
    return RawCamera(
        name=name,
        size_px=size_px,
        matrix=matrix,
        distortion=distortion,
        rotation=rotation,
        translation_m=-rotation @ numbers(frame, "POSITION", 3),
        section=element.get("NAME", ""),
    )


def _floats(text: str) -> np.ndarray:
    """Numbers of a text; an empty array if a word is no number."""
    try:
        return np.array([float(word) for word in text.split()])
    except ValueError:
        return np.empty(0)


def _lens(frame: Any, principal_px: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Centre and three coefficients of the radial distortion; ``None`` for another model."""
    model, *words = frame.get("VICON_RADIAL2", "").split() or [_MODEL]
    new, old = _floats(" ".join(words)), _floats(frame.get("VICON_RADIAL", ""))
    if model != _MODEL:
        return None
    if len(new):
        centre_px, radial = new[:2], new[2:]
    else:
        centre_px, radial = principal_px, old
    if len(radial) > 3 or not RADIAL.holds(radial) or not PRINCIPAL_POINT_PX.holds(centre_px):
        return None
    return centre_px, np.append(radial, np.zeros(3 - len(radial)))


def fitted(centre_px: np.ndarray, radial: np.ndarray, size_px: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
    """OpenCV's coefficients by least squares over the picture; ``None`` if they are off by over half a pixel.

    They are k1, k2, p1, p2, k3, and for wide lenses also k4, k5, k6.
    """
    if not radial.any():
        return np.zeros(5)
    seen_px = np.stack(np.meshgrid(*(np.linspace(0, side - 1, _NUM_SAMPLES) for side in size_px)), -1).reshape(-1, 2)
    offset_px = seen_px - centre_px
    # Growth of the radius; in a picture that folds back on itself it is negative somewhere.
    r2 = np.linspace(0.0, (offset_px**2).sum(-1).max(), _NUM_SAMPLES)
    if (1 + r2 * (3 * radial[0] + r2 * (5 * radial[1] + r2 * 7 * radial[2])) <= _MIN_GROWTH).any():
        return None
    r2 = (offset_px**2).sum(-1, keepdims=True)
    ideal_px = seen_px + offset_px * r2 * (radial[0] + r2 * (radial[1] + r2 * radial[2]))
    focal_px, principal_px = matrix.diagonal()[:2], matrix[:2, 2]
    x, y = ((ideal_px - principal_px) / focal_px).T

    def residuals_px(coefficients: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            seen = _distorted(x, y, coefficients)
        return np.nan_to_num((seen * focal_px + principal_px - seen_px).ravel(), nan=_FAR_PX, posinf=_FAR_PX)

    for num_coefficients in (5, 8):
        # Imported here: most calibrations need no SciPy.
        from scipy.optimize import least_squares  # noqa: PLC0415

        fit = least_squares(residuals_px, np.zeros(num_coefficients), method="lm")
        error_px = np.linalg.norm(residuals_px(fit.x).reshape(-1, 2), axis=-1).max()
        if error_px <= _MAX_RESIDUAL_PX[num_coefficients]:
            return np.asarray(fit.x)
    return None


def _distorted(x: np.ndarray, y: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Points of the image plane where OpenCV's lens shows ideal ones."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.append(coefficients, np.zeros(8 - len(coefficients)))
    r2 = x * x + y * y
    growth = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.stack(
        [
            x * growth + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * growth + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )
