"""Camera of a mapping, by the names of fields that OpenCV's documentation, its samples and programs on it use.

``x = K (R X + t)``. Matrices are nested lists, or flat ones row after row. MATLAB and JARVIS write K and R transposed,
for points that are rows; the place of the principal point tells.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.readers.rotations import read_rotation
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import RawCamera
from pipeline.parsing import UnreadableError, read_numbers
from pipeline.problem_codes.sessions import IMAGE_SIZE, UNSUPPORTED_LENS

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
_SIZE = (IMAGE_SIZE, "imageSize", "imgSize", "img_size", "resolution", "size")
_WIDTH = ("image_width", "image_Width", "imageWidth", "width", "W")
_HEIGHT = ("image_height", "image_Height", "imageHeight", "height", "H")
_LENS = ("distortion_model", "camera_model", "lens_model", "model")
_FISHEYE = ("fisheye", "fisheye_model", "is_fisheye")
_FISHEYE_MODELS = frozenset({"fisheye", "equidistant", "kannala_brandt", "kannala-brandt", "opencv_fisheye"})
_UNSUPPORTED_MODELS = frozenset({"omnidir", "omni", "mei"})
_OF_LENS = (*_MATRIX, *_DISTORTION, *_LENS, *_FISHEYE)
_OF_POSE = (*_ROTATION, *_TRANSLATION, *_TRANSFORM)
_KNOWN = frozenset({"name", "CameraMatrixInitial", *_OF_LENS, *_OF_POSE, *_SIZE, *_WIDTH, *_HEIGHT})
_OF_CAMERA = (*_MATRIX, *_OF_POSE)


def is_camera(fields: Any) -> bool:
    """Return whether a value is a mapping with the matrix or the pose of a camera."""
    return isinstance(fields, Mapping) and _first(fields, _OF_CAMERA) is not None


def has_matrix(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping has the matrix of a camera."""
    return _first(fields, _MATRIX) is not None


def read_camera(name: str, fields: Mapping[str, Any], reading: Reading) -> RawCamera:
    """Take the values of a camera out of its fields; what is malformed is left to the checks."""
    reading.pass_over(fields, _KNOWN)
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
    return RawCamera(
        name=name,
        size_px=_size(fields),
        matrix=matrix,
        distortion=[] if distortion is None else flat(distortion),
        rotation=cam_from_world,
        translation_m=flat(translation),
        lens="fisheye" if _is_fisheye(fields) else "standard",
    )


def _first(fields: Mapping[str, Any], names: Sequence[str]) -> Any:
    return next((fields[name] for name in names if fields.get(name) is not None), None)


def _is_fisheye(fields: Mapping[str, Any]) -> bool:
    return _first(fields, _FISHEYE) not in (None, False, 0, "false") or _model(fields) in _FISHEYE_MODELS


def _model(fields: Mapping[str, Any]) -> str:
    """Name of the lens model in lower case, empty if there is none."""
    model = _first(fields, _LENS)
    return model.lower() if isinstance(model, str) else ""


def _size(fields: Mapping[str, Any]) -> Any:
    width, height = _first(fields, _WIDTH), _first(fields, _HEIGHT)
    if width is not None and height is not None:
        return [width, height]
    size = _first(fields, _SIZE)
    return UNKNOWN_SIZE if size is None else flat(size)


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
