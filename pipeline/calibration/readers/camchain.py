"""Chains of cameras in YAML: Kalibr's ``camchain.yaml``, and MAMMA's file, whose lenses have the same fields.

Kalibr: cameras ``cam0``, ``cam1``, ... with ``T_cn_cnm1``, the transform from the camera before. The world is the first
camera's, or the body's where every camera has ``T_cam_imu``. MAMMA: cameras by name under ``cameras``. Quaternion and
translation are the camera's pose in the world, or the transform from the world (``extrinsics_convention: world2cam``).

Rows of the table of formats:

| Kalibr | `.yaml`, cameras `cam0`, ... with `distortion_model`, `distortion_coeffs` | m | axes of the IMU
(`T_cam_imu`), else of the first camera, turned to Z up as the upright cameras tell; videos may be called by the start
of `rostopic` |
| MAMMA | `.yaml`, cameras with `rotation_quaternion` | m | as calibrated; `extrinsics_convention` and
`quaternion_order` are followed |
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.fields import quaternion_matrix
from pipeline.calibration.readers.vicon import RADIAL, fitted
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.calibration.vertical import upright_by_cameras
from pipeline.core.parsing import PRINCIPAL_POINT_PX, SIDE_PX, TRANSLATION, UnreadableError, read_numbers
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE, INVALID_ROTATION, UNSUPPORTED_LENS

# Number of coefficients of each lens model.
_COEFFICIENTS = {"none": (0,), "radtan": (4,), "equidistant": (4,), "vicon_radial_2": (5,)}
_LENS = frozenset({"camera_model", "distortion_model", "intrinsics", "distortion_coeffs", "resolution"})
_OF_KALIBR = frozenset({"T_cn_cnm1", "T_cam_imu", "cam_overlaps", "rostopic", "timeshift_cam_imu", "timeshift_cn_cnm1"})
_OF_MAMMA = frozenset({"translation", "rotation_quaternion", "cam_name"})
_CONVENTIONS = {"extrinsics_convention": ("cam2world", "world2cam"), "quaternion_order": ("wxyz", "xyzw")}
_MAX_ENTRY = 10.0


def is_rig(fields: Mapping[str, Any]) -> bool:
    """Return whether a mapping has a camera with the fields of these formats."""
    return any(isinstance(camera, dict) and camera.keys() >= _LENS for camera in _cameras(fields).values())


def read(fields: Mapping[str, Any], file: str) -> CameraFile:
    """Read the cameras of a mapping; ``InputError`` lists all its problems."""
    reading = Reading(file)
    cameras = {name: camera for name, camera in _cameras(fields).items() if isinstance(camera, dict)}
    # One camera above the limit suffices to report that there are too many.
    cameras = dict(islice(cameras.items(), MAX_CAMERAS + 1))
    if any("rotation_quaternion" in camera for camera in cameras.values()):
        stated = {field: str(fields.get(field, values[0])).lower() for field, values in _CONVENTIONS.items()}
        for field, values in _CONVENTIONS.items():
            if stated[field] not in values:
                reading.complain(CALIBRATION_UNREADABLE, f"The field must be {' or '.join(values)}.", field=field)
        order, is_inverse = stated["quaternion_order"], stated["extrinsics_convention"] == "world2cam"
        raw = [
            _raw(name, camera, _posed(name, camera, order, is_inverse, reading), reading)
            for name, camera in cameras.items()
        ]
        reading.pass_over(fields, frozenset({"cameras", *_CONVENTIONS}))
        return reading.contents("MAMMA YAML", raw, "m")
    raw = [_raw(name, cameras[name], pose, reading) for name, pose in _chain(cameras, reading)]
    reading.pass_over(fields, frozenset(cameras))
    note = "the cameras don't tell the vertical; the first camera is taken to be upright"
    return upright_by_cameras(reading.contents("Kalibr", raw, "m"), "-y", f"{file}: {note}.")


def _cameras(fields: Mapping[str, Any]) -> Mapping[str, Any]:
    listed = fields.get("cameras", fields)
    return listed if isinstance(listed, dict) else {}


def _posed(name: str, camera: Mapping[str, Any], order: str, is_inverse: bool, reading: Reading) -> np.ndarray | None:
    """Transform from the world of a camera of MAMMA; ``None`` without a pose."""
    if camera.get("translation") is None or camera.get("rotation_quaternion") is None:
        return None
    try:
        quaternion, place_m = (read_numbers(camera[field]) for field in ("rotation_quaternion", "translation"))
        turn = quaternion_matrix(quaternion if order == "xyzw" else np.roll(quaternion, -1))
        is_place = place_m.shape == (3,) and TRANSLATION.holds(place_m)
    except UnreadableError:
        is_place = False
    if not is_place:
        message = "The pose must be a quaternion of 4 numbers, and a translation of 3 numbers in metres."
        reading.complain(INVALID_ROTATION, message, name, "rotation_quaternion")
        return np.eye(3, 4)
    return np.column_stack([turn, place_m] if is_inverse else [turn.T, -turn.T @ place_m])


def _chain(cameras: Mapping[str, Mapping[str, Any]], reading: Reading) -> Iterator[tuple[str, np.ndarray | None]]:
    """Transform from the world of each camera of Kalibr; ``None`` from a break of the chain on."""
    if all("T_cam_imu" in camera for camera in cameras.values()):
        steps = {name: _transform(name, camera["T_cam_imu"], "T_cam_imu", reading) for name, camera in cameras.items()}
        yield from ((name, None if step is None else step[:3]) for name, step in steps.items())
        return
    before: np.ndarray | None = np.eye(4)
    for number, (name, camera) in enumerate(cameras.items()):
        step = _transform(name, camera.get("T_cn_cnm1"), "T_cn_cnm1", reading) if number else np.eye(4)
        before = None if step is None or before is None else step @ before
        yield name, None if before is None else before[:3]


def _transform(name: str, value: Any, field: str, reading: Reading) -> np.ndarray | None:
    if value is None:
        return None
    try:
        matrix = read_numbers(value)
    except UnreadableError:
        matrix = np.empty(0)
    if matrix.shape == (4, 4) and (np.abs(matrix[:3, :3]) < _MAX_ENTRY).all() and TRANSLATION.holds(matrix[:3, 3]):
        return matrix
    reading.complain(INVALID_ROTATION, "The transform must have 4 x 4 plausible numbers.", name, field)
    return np.eye(4)


def _raw(name: str, camera: Mapping[str, Any], pose: np.ndarray | None, reading: Reading) -> RawCamera:
    model, intrinsics = str(camera.get("distortion_model", "none")).lower(), camera.get("intrinsics")
    if camera.get("camera_model", "pinhole") != "pinhole" or model not in _COEFFICIENTS:
        message = f"The lens model {str(camera.get('camera_model'))[:40]} with {model[:40]} is not supported."
        hint = f"Calibrate with the camera model pinhole and one of {', '.join(_COEFFICIENTS)}."
        reading.complain(UNSUPPORTED_LENS, message, name, hint=hint)
    matrix: Any = "unreadable"
    if isinstance(intrinsics, list) and len(intrinsics) == 4:
        fx, fy, cx, cy = intrinsics
        matrix = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    coefficients = camera.get("distortion_coeffs", [])
    if model == "vicon_radial_2":
        coefficients = _by_vicon(name, coefficients, camera.get("resolution"), matrix, reading)
    raw = RawCamera(
        name=name,
        size_px=camera.get("resolution"),
        matrix=matrix,
        distortion=coefficients,
        rotation=None if pose is None else pose[:, :3],
        translation_m=None if pose is None else pose[:, 3].tolist(),
        section=str(camera.get("rostopic", "")).strip("/").partition("/")[0],
        lens="fisheye" if model == "equidistant" else "standard",
    )
    reading.pass_over(camera, _LENS | _OF_KALIBR | _OF_MAMMA, raw)
    return raw


def _by_vicon(name: str, coefficients: Any, size_px: Any, matrix: Any, reading: Reading) -> Any:
    """OpenCV's coefficients of Vicon's lens: centre in pixels, then three numbers that lead to ideal pixels."""
    try:
        numbers, sides_px, camera_matrix = (read_numbers(value) for value in (coefficients, size_px, matrix))
    except UnreadableError:
        return coefficients
    fit = None
    is_plausible = numbers.shape == (5,) and sides_px.shape == (2,) and camera_matrix.shape == (3, 3)
    if is_plausible and SIDE_PX.holds(sides_px) and PRINCIPAL_POINT_PX.holds(numbers[:2]) and RADIAL.holds(numbers[2:]):
        fit = fitted(numbers[:2], numbers[2:], sides_px, camera_matrix)
    if fit is None:
        message = "Vicon's lens needs a centre and three coefficients that are plausible."
        reading.complain(UNSUPPORTED_LENS, message, name, "distortion_coeffs")
    return np.zeros(5) if fit is None else fit
