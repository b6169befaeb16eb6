"""OpenCV's FileStorage and files with the same names of fields, and EasyMocap's ``intri.yml`` with ``extri.yml``.

OpenCV does not determine how a rig is stored. Read are a mapping (or a list) of cameras, each with the names of
fields that OpenCV's documentation and samples use, and EasyMocap's one mapping with a suffix a camera. Transforms map
the world to the camera: ``x = K (R X + t)``.
"""

from collections.abc import Mapping
from itertools import islice
from typing import Any

from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.readers.rotations import read_rotation
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.parsing import UnreadableError, read_numbers
from pipeline.problem_codes.sessions import IMAGE_SIZE, UNSUPPORTED_LENS

_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix", "intrinsics", "mtx", "matrix", "K")
_DISTORTION = (
    "distortion_coefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "distCoeffs",
    "distortion",
    "distortions",
    "dist",
    "D",
)
_ROTATION = ("rotation_matrix", "rotation", "rvec", "R")
_TRANSLATION = ("translation_vector", "translation", "tvec", "T", "t")
_TRANSFORM = ("extrinsic_matrix", "extrinsics", "extrinsic", "RT")
_SIZE = (IMAGE_SIZE, "imageSize", "img_size", "resolution", "size")
_WIDTH = ("image_width", "image_Width", "imageWidth", "width", "W")
_HEIGHT = ("image_height", "image_Height", "imageHeight", "height", "H")
_LENS = ("distortion_model", "camera_model", "lens_model", "model")
_FISHEYE = ("fisheye", "fisheye_model", "is_fisheye")
_FISHEYE_MODELS = frozenset({"fisheye", "equidistant", "kannala_brandt", "kannala-brandt", "opencv_fisheye"})
_FIELDS = frozenset().union(
    ("name",), _MATRIX, _DISTORTION, _ROTATION, _TRANSLATION, _TRANSFORM, _SIZE, _WIDTH, _HEIGHT, _LENS, _FISHEYE
)
_UNSUPPORTED_MODELS = frozenset({"omnidir", "omni", "mei"})

_RIG = "OpenCV"
_EASYMOCAP = "EasyMocap"


def read_fields(fields: Mapping[str, Any], file: str) -> CameraFile | None:
    """Read the cameras of a mapping; ``None`` if it has no camera of these formats.

    Raises ``InputError`` with all problems of all cameras.
    """
    names = _easymocap_names(fields)
    if names:
        cameras = {name: _easymocap_fields(fields, name) for name in islice(names, MAX_CAMERAS + 1)}
        return _contents(_EASYMOCAP, cameras, file)
    listed = fields.get("cameras", fields)
    if isinstance(listed, list) and all(
        isinstance(item, dict) and isinstance(item.get("name"), str) for item in listed
    ):
        listed = {item["name"]: item for item in listed}
    if not isinstance(listed, dict):
        return None
    rig = {name: item for name, item in listed.items() if isinstance(item, dict) and _first(item, _MATRIX) is not None}
    return _contents(_RIG, dict(islice(rig.items(), MAX_CAMERAS + 1)), file) if rig else None


def is_camera(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping is a camera of its own, as of a file a camera."""
    return _first(fields, _MATRIX) is not None


def _easymocap_names(fields: Mapping[str, Any]) -> list[str]:
    """Names of the cameras with a matrix ``K_name``."""
    return [key.removeprefix("K_") for key, value in fields.items() if key.startswith("K_") and isinstance(value, list)]


def _easymocap_fields(fields: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Fields of one camera without its name; the matrix ``Rot_name`` goes before the vector ``R_name``."""
    own = {
        key: fields.get(f"{prefix}_{name}")
        for key, prefix in (("K", "K"), ("dist", "dist"), ("T", "T"), ("W", "W"), ("H", "H"))
    }
    own["R"] = fields.get(f"Rot_{name}", fields.get(f"R_{name}"))
    own["dist"] = fields.get(f"D_{name}") if own["dist"] is None else own["dist"]
    return {key: value for key, value in own.items() if value is not None}


def _contents(name: str, cameras: Mapping[str, Mapping[str, Any]], file: str) -> CameraFile:
    reading = Reading(file)
    raw = [_raw(camera, fields, reading) for camera, fields in cameras.items()]
    # EasyMocap's documentation: T must be in metres.
    return reading.contents(name, raw, "m" if name == _EASYMOCAP else None)


def _first(fields: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((fields[name] for name in names if fields.get(name) is not None), None)


def _raw(name: str, fields: Mapping[str, Any], reading: Reading) -> RawCamera:
    reading.pass_over(fields, _FIELDS)
    if _model(fields) in _UNSUPPORTED_MODELS:
        message = "Omnidirectional lens models are not supported."
        hint = "Undistort the videos, or calibrate with the standard or the fisheye model."
        reading.complain(UNSUPPORTED_LENS, message, name, hint=hint)
    rotation, translation = _first(fields, _ROTATION), _first(fields, _TRANSLATION)
    transform = _first(fields, _TRANSFORM)
    if rotation is None and transform is not None:
        rotation, translation = _halves(transform)
    distortion = _first(fields, _DISTORTION)
    return RawCamera(
        name=name,
        size_px=_size(fields),
        matrix=_first(fields, _MATRIX),
        distortion=[] if distortion is None else _flat(distortion),
        rotation=read_rotation(rotation, name, reading),
        translation_m=_flat(translation),
        section="",
        lens="fisheye" if _is_fisheye(fields) else "standard",
    )


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
    return UNKNOWN_SIZE if size is None else _flat(size)


def _flat(value: Any) -> Any:
    """Flatten a row or a column of numbers; other values are left to the checks."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
        return value[0]
    if isinstance(value, list) and all(isinstance(item, list) and len(item) == 1 for item in value):
        return [item[0] for item in value]
    return value


def _halves(transform: Any) -> tuple[Any, Any]:
    """Rotation and translation of a matrix of 3 x 4 or 4 x 4 numbers, ``None`` for other values."""
    try:
        matrix = read_numbers(transform)
    except UnreadableError:
        return None, None
    if matrix.shape not in {(3, 4), (4, 4)}:
        return None, None
    return matrix[:3, :3].tolist(), matrix[:3, 3].tolist()
