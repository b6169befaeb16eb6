"""Camera of a mapping, by the names of fields that OpenCV's documentation, its samples and programs on it use.

``x = K (R X + t)``. Matrices are nested lists, or flat ones row after row. MATLAB and JARVIS write K and R transposed,
for points that are rows; the place of the principal point tells.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import RawCamera
from pipeline.core.errors import listed_names
from pipeline.core.parsing import ROTATION_VECTOR_RAD, UnreadableError, read_numbers
from pipeline.core.problems.session_codes import INVALID_ROTATION, INVALID_SIZE, UNSUPPORTED_LENS

_MIN_NORM, _MAX_NORM = 1e-3, 1e3


def read_rotation(value: Any, camera: str, reading: Reading) -> np.ndarray | None:
    """Matrix of a Rodrigues vector (radians) in a list, a row or a column, or the matrix itself; ``None`` if missing.

    Another value is a problem of the camera. The checks tell if a matrix is a rotation.
    """
    if value is None:
        return None
    try:
        array = read_numbers(value)
    except UnreadableError:
        array = np.empty(0)
    if array.shape == (3, 3):
        return array
    if array.size == max(array.shape, default=0) == 3 and ROTATION_VECTOR_RAD.holds(array):
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

        return Rotation.from_rotvec(array.ravel()).as_matrix()
    message = f"The rotation is neither a matrix of 3 x 3 numbers nor a vector of 3 numbers from {ROTATION_VECTOR_RAD}."
    reading.complain(INVALID_ROTATION, message, camera, "rotation")
    return np.eye(3)  # so that the problem is reported only once


def quaternion_matrix(xyzw: np.ndarray) -> np.ndarray:
    """Matrix of a quaternion with the scalar last, of any plausible length; raises ``UnreadableError`` for others."""
    if xyzw.shape != (4,) or not _MIN_NORM < np.abs(xyzw).max() < _MAX_NORM:
        raise UnreadableError
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

    return Rotation.from_quat(xyzw).as_matrix()


_MATRIX = (
    "camera_matrix",
    "cameraMatrix",
    "Camera_Matrix",
    "intrinsic_matrix",
    "intrinsicMatrix",
    "intrinsics",
    "Intrinsics",
    "mtx",
    "matrix",
    "K",
)
_DISTORTION = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "distortionCoefficients",
    "dist_coeffs",
    "distCoeffs",
    "distCoeff",
    "distCoef",
    "discCoef",
    "dist_coef",
    "dist_coeff",
    "distortion_coeffs",
    "distortion",
    "Distortion",
    "distortions",
    "dist",
    "D",
)
_ROTATION = ("rotation_matrix", "rotation", "rvec", "R")
_TRANSLATION = ("translation_vector", "translation", "tvec", "T", "t")
# OpenPose's ``CameraMatrix`` is the pose.
_TRANSFORM = ("extrinsic_matrix", "extrinsics", "extrinsic", "RT", "CameraMatrix")
# In lower case and without ``_`` and ``-``: ``imgSize``, ``img_size``, ``Image-Size``.
_SIZE = re.compile("(image|img|im|frame|video|picture)?(size|resolution)(px)?")
_WIDTH = re.compile("((image|img|im|frame|video|picture)?width|(image|img|im)?w|resx)(px)?")
_HEIGHT = re.compile("((image|img|im|frame|video|picture)?height|(image|img|im)?h|resy)(px)?")
# NumPy's shape of a picture: rows, columns, and perhaps channels.
_SHAPE = re.compile("(image|img|im|frame|video|picture)?shape")
_LENS = ("distortion_model", "distortionModel", "camera_model", "cameraModel", "lens_model", "lensModel", "model")
_FISHEYE = ("fisheye", "fisheye_model", "is_fisheye")
_FISHEYE_MODELS = frozenset({"fisheye", "equidistant", "kannala_brandt", "kannala-brandt", "opencv_fisheye"})
_UNSUPPORTED_MODELS = frozenset({"omnidir", "omni", "mei"})
_OF_LENS = (*_MATRIX, *_DISTORTION, *_LENS, *_FISHEYE)
_OF_POSE = (*_ROTATION, *_TRANSLATION, *_TRANSFORM)
_KNOWN = frozenset({"name", "CameraMatrixInitial", *_OF_LENS, *_OF_POSE})
_OF_CAMERA = (*_MATRIX, *_OF_POSE)


def is_camera(fields: Any) -> bool:
    """Return whether a value is a mapping with the matrix or the pose of a camera."""
    return isinstance(fields, Mapping) and _first(fields, _OF_CAMERA) is not None


def has_matrix(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping has the matrix of a camera."""
    return _first(fields, _MATRIX) is not None


def read_camera(name: str, fields: Mapping[str, Any], reading: Reading) -> RawCamera:
    """Take the values of a camera out of its fields; what is malformed is left to the checks."""
    if _model(fields) in _UNSUPPORTED_MODELS:
        message = "Omnidirectional lens models are not supported."
        hint = "Undistort the videos, or calibrate with the standard or the fisheye model."
        reading.complain(UNSUPPORTED_LENS, message, name, hint=hint)
    rotation, translation = _first(fields, _ROTATION), _first(fields, _TRANSLATION)
    transform = _first(fields, _TRANSFORM)
    if rotation is None and transform is not None:
        rotation, translation = _halves(_in_rows(transform, 12, 16))
    matrix, rotation = _in_rows(_first(fields, _MATRIX), 9), _in_rows(rotation, 9)
    if is_transposed := _is_transposed(matrix):
        matrix = np.transpose(matrix)
    cam_from_world = read_rotation(rotation, name, reading)
    if is_transposed and cam_from_world is not None and np.shape(rotation) == (3, 3):
        cam_from_world = cam_from_world.T
    distortion = _first(fields, _DISTORTION)
    raw = RawCamera(
        name=name,
        size_px=read_size(name, fields, reading),
        matrix=matrix,
        distortion=[] if distortion is None else flat(distortion),
        rotation=cam_from_world,
        translation_m=flat(translation),
        lens="fisheye" if _is_fisheye(fields) else "standard",
    )
    reading.pass_over(fields, _KNOWN | size_names(fields), raw)
    return raw


def size_names(fields: Mapping[str, Any]) -> frozenset[str]:
    """Names of the fields that state the size of the picture, or a side of it."""
    return frozenset(
        name for name in fields if any(pattern.fullmatch(_plain(name)) for pattern in (_SIZE, _SHAPE, _WIDTH, _HEIGHT))
    )


def read_size(name: str, fields: Mapping[str, Any], reading: Reading) -> Any:
    """Width and height of a camera's picture, ``UNKNOWN_SIZE`` if no field states them.

    Fields that contradict each other are a problem of the camera.
    """
    stated: dict[str, Any] = {}
    for field, value in fields.items():
        if value is not None and _SIZE.fullmatch(_plain(field)):
            stated[field] = flat(value)
        elif isinstance(value, list) and _SHAPE.fullmatch(_plain(field)):
            stated[field] = value[1::-1]
    widths, heights = _named(fields, _WIDTH), _named(fields, _HEIGHT)
    if widths and heights:
        pairs = [*((width, heights[0]) for width in widths), *((widths[0], height) for height in heights)]
        stated |= {f"{width} and {height}": [fields[width], fields[height]] for width, height in pairs}
    sizes = list(stated.values())
    if any(size != sizes[0] for size in sizes):
        message = f"The fields {listed_names(list(stated))} state different sizes of the picture."
        reading.complain(INVALID_SIZE, message, name, "size", "Keep the size that the camera matrix is of.")
    return sizes[0] if sizes else UNKNOWN_SIZE


def _named(fields: Mapping[str, Any], pattern: re.Pattern[str]) -> list[str]:
    """Fields with a name of the pattern and a value that is no list: ``H`` may be a homography."""
    return [
        field
        for field, value in fields.items()
        if value is not None and not isinstance(value, list | dict) and pattern.fullmatch(_plain(field))
    ]


def _plain(name: str) -> str:
    return name.lower().replace("_", "").replace("-", "")


def _first(fields: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((fields[name] for name in names if fields.get(name) is not None), None)


def _is_fisheye(fields: Mapping[str, Any]) -> bool:
    return _first(fields, _FISHEYE) not in (None, False, 0, "false") or _model(fields) in _FISHEYE_MODELS


def _model(fields: Mapping[str, Any]) -> str:
    """Name of the lens model in lower case, empty if there is none."""
    model = _first(fields, _LENS)
    return model.lower() if isinstance(model, str) else ""


def flat(value: Any) -> Any:
    """Flatten a row or a column of numbers; other values are left to the checks."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
        return value[0]
    if isinstance(value, list) and all(isinstance(item, list) and len(item) == 1 for item in value):
        return [item[0] for item in value]
    return value


def _in_rows(value: Any, *sizes: int) -> Any:
    """Cut a flat list of so many numbers into rows as long as a matrix of its size has."""
    if not isinstance(value, list) or len(value) not in sizes or any(isinstance(item, list) for item in value):
        return value
    length = 3 if len(value) == 9 else 4
    return [value[start : start + length] for start in range(0, len(value), length)]


def _is_transposed(matrix: Any) -> bool:
    """Return whether a camera matrix has its principal point in the last row."""
    try:
        numbers = read_numbers(matrix)
    except UnreadableError:
        return False
    return numbers.shape == (3, 3) and bool((numbers[:2, 2] == 0).all() and (numbers[2, :2] != 0).any())


def _halves(transform: Any) -> tuple[Any, Any]:
    """Rotation and translation of a matrix of 3 x 4 or 4 x 4 numbers, ``None`` for other values."""
    try:
        matrix = read_numbers(transform)
    except UnreadableError:
        return None, None
    if matrix.shape not in {(3, 4), (4, 4)}:
        return None, None
    return matrix[:3, :3].tolist(), matrix[:3, 3].tolist()
