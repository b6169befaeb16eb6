"""Vicon calibration (``.xcp``): the video cameras, in their first key frame.

Lengths are millimetres; ORIENTATION is the quaternion (x, y, z, w) from world to camera, POSITION the camera's centre.
``VICON_RADIAL`` (k1, k2) and the newer ``VICON_RADIAL2`` (``Vicon3Parameter``, centre, k1, k2, k3) map distorted to
ideal pixels: ``ideal = c + (seen - c) (1 + k1 r^2 + k2 r^4 + k3 r^6)``, r in pixels. OpenCV's model has the other
direction, so its coefficients are fitted.
"""

from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.rotations import quaternion_matrix
from pipeline.calibration.readers.xml_files import NUMBER, read_root, video_cameras
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.parsing import FOCAL_LENGTH_PX, PRINCIPAL_POINT_PX, SIDE_PX, Quantity, UnreadableError
from pipeline.problem_codes.sessions import INVALID_NUMBER, INVALID_ROTATION, UNSUPPORTED_LENS

ROOT = "Cameras"

_ASPECT = Quantity(0.01, 100, "")
# Coefficients in pixels are about 1e-8, 1e-15 and 1e-22.
_RADIAL = Quantity(-1e-4, 1e-4, "")
_MODEL = "Vicon3Parameter"
_NUM_SAMPLES = 25
_MAX_RESIDUAL_PX = 0.5
_MAX_SHARE = 0.5


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
    return "video" in element.get("TYPE", "").lower()


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
    distortion = None if lens is None else _fitted(*lens, size_px, matrix)
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
    if len(radial) > 3 or not _RADIAL.holds(radial) or not PRINCIPAL_POINT_PX.holds(centre_px):
        return None
    return centre_px, np.append(radial, np.zeros(3 - len(radial)))


def _fitted(centre_px: np.ndarray, radial: np.ndarray, size_px: np.ndarray, matrix: np.ndarray) -> np.ndarray | None:
    """OpenCV's k1, k2, p1, p2, k3 by least squares over the picture; ``None`` if they are off by over half a pixel."""
    if not radial.any():
        return np.zeros(5)
    seen_px = np.stack(np.meshgrid(*(np.linspace(0, side - 1, _NUM_SAMPLES) for side in size_px)), -1).reshape(-1, 2)
    offset_px = seen_px - centre_px
    r2 = (offset_px**2).sum(-1, keepdims=True)
    growth = r2 * (radial[0] + r2 * (radial[1] + r2 * radial[2]))
    # A picture that folds back on itself is no lens.
    if np.abs(growth).max() > _MAX_SHARE:
        return None
    focal_px, principal_px = matrix.diagonal()[:2], matrix[:2, 2]
    x, y = ((seen_px + offset_px * growth - principal_px) / focal_px).T
    displacement = -offset_px * growth / focal_px
    r2 = x * x + y * y
    columns = np.stack(
        [
            np.concatenate([x * r2, y * r2]),
            np.concatenate([x * r2**2, y * r2**2]),
            np.concatenate([2 * x * y, r2 + 2 * y * y]),
            np.concatenate([r2 + 2 * x * x, 2 * x * y]),
            np.concatenate([x * r2**3, y * r2**3]),
        ],
        axis=-1,
    )
    target = np.concatenate([displacement[:, 0], displacement[:, 1]])
    coefficients = np.linalg.lstsq(columns, target, rcond=None)[0]
    residual_px = np.abs(columns @ coefficients - target).max() * focal_px.max()
    return coefficients if residual_px <= _MAX_RESIDUAL_PX else None
