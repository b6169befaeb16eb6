"""Calibrations of data sets in JSON: CMU Panoptic, VoxelPose's files of Shelf and Campus, Human3.6M, CAMMA's MVOR.

Panoptic: ``x = K (R X + t)``, centimetres, the world's y axis points down. VoxelPose: ``x = K R (X - T)``, so T is the
camera's centre, millimetres; Faster-VoxelPose has a list of cameras a sequence. Human3.6M has the intrinsics of each
camera once and its pose for each subject, ``x = K (R X + t)``, millimetres. MVOR's annotations hold the cameras:
transforms by rows from each camera to the first one, and from that one to the room, millimetres.

Rows of the table of formats:

| CMU Panoptic | `.json`, cameras with `distCoef` | cm | y down, turned to Z up; videos may be called `hd_00_00` |
| VoxelPose, Faster-VoxelPose | `.json`, cameras with `fx`, `fy`, `cx`, `cy`, `k`, `p`, or the list of one sequence | mm
| as calibrated; `T` is the centre of the camera; sizes of pictures beside the camera or beside all; videos may be
called `Camera0` |
| Human3.6M | `.json` with `intrinsics` and `extrinsics` of subjects (`camera-parameters.json`); or cameras with `R`,
`t`, `f`, `c` (`Human36M_subject9_camera.json`) | mm | Z up; the name of the file has the subject, such as
`camera-parameters-S9.json`, if the file has several |
| MVOR (CAMMA) | `.json` with `cameras_info`: the annotations `camma_mvor_2018.json` | mm | Z up; cameras are called
`cam1`, `cam2`, ...; the distortion is ignored, because the pictures have none |
"""

import re
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from pipeline.calibration.contents import CameraFile
from pipeline.calibration.readers.fields import read_size, size_names
from pipeline.calibration.reading import Reading
from pipeline.calibration.validate import MAX_CAMERAS, RawCamera
from pipeline.core.errors import listed_names
from pipeline.core.parsing import UnreadableError, read_numbers
from pipeline.core.problems.session_codes import CALIBRATION_UNREADABLE

_PANOPTIC = frozenset({"K", "R", "t", "distCoef", "resolution"})
_PANOPTIC_PASSED_OVER = frozenset({"name", "type", "panel", "node"})
_VOXELPOSE = frozenset({"R", "T", "fx", "fy", "cx", "cy", "k", "p"})
_HUMAN36M, _HUMAN36M_LENS = frozenset({"intrinsics", "extrinsics"}), frozenset({"calibration_matrix", "distortion"})
_HUMAN36M_PLAIN = frozenset({"R", "t", "f", "c"})
# Starts of the names of video files, by the type of camera.
_VIDEOS = {"hd": "hd", "vga": "vga", "kinect-color": "kinect"}
# From a world with z up to Panoptic's, whose y points down.
_PANOPTIC_FROM_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def is_panoptic(listed: Sequence[Any]) -> bool:
    """Return whether all cameras of a list have Panoptic's fields."""
    return bool(listed) and all(isinstance(camera, dict) and camera.keys() >= _PANOPTIC for camera in listed)


def read_document(document: Mapping[str, Any], file: str) -> CameraFile | None:
    """Read a JSON object of one of these data sets; ``None`` if it is of neither.

    Raises ``InputError`` with all problems of all cameras.
    """
    listed = document.get("cameras")
    if isinstance(listed, list) and is_panoptic(listed):
        return _read_panoptic(listed, file)
    if cameras := _voxelpose_cameras(document):
        # One camera above the limit suffices to report that there are too many.
        reading = Reading(file)
        raw = [_raw_voxelpose(name, camera, reading) for name, camera in islice(cameras.items(), MAX_CAMERAS + 1)]
        return reading.contents("VoxelPose JSON", raw, "mm")
    if (human36m := _read_human36m(document, file)) is not None:
        return human36m
    information = document.get("cameras_info")
    if isinstance(information, dict) and isinstance(parameters := information.get("camParams"), dict):
        return _read_mvor(parameters, file)
    return None


def _voxelpose_cameras(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """Cameras by name, also of one sequence's list or mapping; empty if they are not VoxelPose's.

    A size beside the cameras is the size of all pictures.
    """
    sizes = {name: document[name] for name in size_names(document)}
    cameras: Any = {name: value for name, value in document.items() if name not in sizes}
    if len(cameras) == 1 and not _is_voxelpose(next(iter(cameras.values()))):
        cameras = next(iter(cameras.values()))
    if isinstance(cameras, list):
        cameras = {str(number): camera for number, camera in enumerate(cameras)}
    if not isinstance(cameras, dict) or not all(map(_is_voxelpose, cameras.values())):
        return {}
    return {name: camera if size_names(camera) else {**camera, **sizes} for name, camera in cameras.items()}


def _is_voxelpose(camera: Any) -> bool:
    return isinstance(camera, dict) and camera.keys() >= _VOXELPOSE


def _read_human36m(document: Mapping[str, Any], file: str) -> CameraFile | None:
    """Read Human3.6M's cameras; ``None`` if the document is of other ones."""
    reading = Reading(file)
    if document and all(isinstance(camera, dict) and camera.keys() >= _HUMAN36M_PLAIN for camera in document.values()):
        plain = dict(islice(document.items(), MAX_CAMERAS + 1))
        reading.notes.append(f"{file}: the file has no distortion; lenses are taken as free of it.")
        raw = [
            _raw_human36m(name, camera, reading, {"calibration_matrix": _matrix(camera["f"], camera["c"])})
            for name, camera in plain.items()
        ]
        for camera, raw_camera in zip(plain.values(), raw, strict=True):
            reading.pass_over(camera, _HUMAN36M_PLAIN | size_names(camera), raw_camera)
        return reading.contents("Human3.6M JSON", raw, "mm")
    lenses, subjects = document.get("intrinsics"), document.get("extrinsics")
    if document.keys() != _HUMAN36M or not isinstance(lenses, dict) or not isinstance(subjects, dict):
        return None
    if not all(isinstance(lens, dict) and lens.keys() >= _HUMAN36M_LENS for lens in lenses.values()):
        return None
    words = set(re.split("[^0-9A-Za-z]+", file))
    named = [subject for subject in subjects if subject in words or len(subjects) == 1]
    if len(named) != 1:
        message = f"The cameras stand elsewhere for each of the subjects {listed_names(list(subjects))}."
        hint = "Put the subject of the take into the name of the file, such as camera-parameters-S9.json."
        reading.complain(CALIBRATION_UNREADABLE, message, field="extrinsics", hint=hint)
    poses = subjects[named[0]] if len(named) == 1 and isinstance(subjects[named[0]], dict) else {}
    limited = dict(islice(lenses.items(), MAX_CAMERAS + 1))
    raw = [_raw_human36m(name, poses.get(name), reading, lens) for name, lens in limited.items()]
    for lens, raw_camera in zip(limited.values(), raw, strict=True):
        reading.pass_over(lens, _HUMAN36M_LENS | size_names(lens), raw_camera)
    return reading.contents("Human3.6M JSON", raw, "mm")


def _raw_human36m(name: str, pose: Any, reading: Reading, lens: Mapping[str, Any]) -> RawCamera:
    fields = pose if isinstance(pose, dict) else {}
    return RawCamera(
        name=name,
        size_px=read_size(name, {**lens, **fields}, reading),
        matrix=lens["calibration_matrix"],
        distortion=_column(lens.get("distortion", [])),
        rotation=fields.get("R"),
        translation_m=None if fields.get("t") is None else _column(fields["t"]),
    )


def _matrix(focal_px: Any, point_px: Any) -> Any:
    """Camera matrix of two focal lengths and the principal point; a text for what they are not."""
    try:
        (fx, fy), (cx, cy) = _row(focal_px), _row(point_px)
    except (UnreadableError, ValueError):
        return "unreadable"
    return [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]


def _read_panoptic(listed: Sequence[Mapping[str, Any]], file: str) -> CameraFile:
    reading = Reading(file)
    if len(listed) > MAX_CAMERAS:
        vga = [camera.get("name") for camera in listed if camera.get("type") == "vga"]
        reading.leave_out(vga, f"VGA, of more than {MAX_CAMERAS} cameras")
        listed = [camera for camera in listed if camera.get("type") != "vga"][: MAX_CAMERAS + 1]
    raw = [_raw_panoptic(camera) for camera in listed]
    for camera, raw_camera in zip(listed, raw, strict=True):
        reading.pass_over(camera, _PANOPTIC | _PANOPTIC_PASSED_OVER, raw_camera)
    return reading.contents("CMU Panoptic JSON", raw, "cm", axes="y down, turned to Z up")


def _raw_panoptic(camera: Mapping[str, Any]) -> RawCamera:
    name = camera.get("name")
    kind = _VIDEOS.get(str(camera.get("type")))
    return RawCamera(
        name=name,
        size_px=camera["resolution"],
        matrix=camera["K"],
        distortion=_column(camera["distCoef"]),
        rotation=_product(camera["R"], _PANOPTIC_FROM_UPRIGHT),
        translation_m=_column(camera["t"]),
        section=f"{kind}_{name}" if kind else "",
    )


def _raw_voxelpose(name: str, camera: Mapping[str, Any], reading: Reading) -> RawCamera:
    try:
        radial, tangential = (_row(camera[key]) for key in ("k", "p"))
        distortion: Any = [*radial[:2], *tangential, *radial[2:]]
    except UnreadableError:
        distortion = "unreadable"
    raw = RawCamera(
        name=name,
        size_px=read_size(name, camera, reading),
        matrix=[[camera["fx"], 0.0, camera["cx"]], [0.0, camera["fy"], camera["cy"]], [0.0, 0.0, 1.0]],
        distortion=distortion,
        rotation=camera["R"],
        translation_m=_from_centre(camera["R"], camera["T"]),
        section=f"Camera{name}",
    )
    reading.pass_over(camera, _VOXELPOSE | size_names(camera), raw)
    return raw


def _read_mvor(parameters: Mapping[str, Any], file: str) -> CameraFile:
    """Read MVOR's cameras, which the folders of its pictures call ``cam1``, ``cam2``, ...

    Its annotations in 3D fit its annotations in 2D without the file's distortion, and the data set's own programs apply
    none: the pictures are undistorted.
    """
    reading = Reading(file)
    intrinsics, extrinsics = (_listed(parameters.get(key)) for key in ("intrinsics", "extrinsics"))
    if len(intrinsics) != len(extrinsics):
        message = f"There are {len(intrinsics)} intrinsics and {len(extrinsics)} extrinsics."
        reading.complain(CALIBRATION_UNREADABLE, message, field="cameras_info", hint="Get the file again.")
    room_from_first = _transform(parameters.get("firstCamToRoomRef"))
    if room_from_first is None:
        message = "A rigid transform has 16 numbers, by rows."
        reading.complain(CALIBRATION_UNREADABLE, message, field="firstCamToRoomRef", hint="Get the file again.")
        room_from_first = np.eye(4)
    reading.notes.append(f"{file}: the pictures of MVOR are undistorted; the distortion in the file is not applied.")
    raw = [
        _raw_mvor(number, camera, room_from_first, first_from_camera)
        for number, (camera, first_from_camera) in enumerate(zip(intrinsics, extrinsics, strict=False), 1)
    ]
    return reading.contents("CAMMA MVOR JSON", raw[: MAX_CAMERAS + 1], "mm", axes="of the room, Z up")


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _raw_mvor(number: int, camera: Any, room_from_first: np.ndarray, first_from_camera: Any) -> RawCamera:
    fields = camera if isinstance(camera, dict) else {}
    matrix = _matrix(fields.get("focallength"), fields.get("principalpoint"))
    if isinstance(matrix, list):
        matrix[0][1] = fields.get("skew_value", 0.0)
    pose = _transform(first_from_camera)
    camera_from_room = None if pose is None else np.linalg.inv(room_from_first @ pose)
    return RawCamera(
        name=f"cam{number}",
        size_px=fields.get("imagesize"),
        matrix=matrix,
        distortion=[0.0] * 5,
        rotation="unreadable" if camera_from_room is None else camera_from_room[:3, :3],
        translation_m=[0.0] * 3 if camera_from_room is None else camera_from_room[:3, 3].tolist(),
    )


def _transform(value: Any) -> np.ndarray | None:
    """Rigid transform of 16 numbers by rows; ``None`` for what is none."""
    try:
        matrix = np.reshape(_row(value), (4, 4))
    except (UnreadableError, ValueError):
        return None
    is_rigid = (
        (np.abs(matrix[:3, :3]) < _MAX_ENTRY).all()
        and (np.abs(matrix[:3, 3]) < _MAX_LENGTH).all()
        and np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-2)
        and np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    )
    return matrix if is_rigid else None


def _row(value: Any) -> list[float]:
    """Numbers of a row or a column; raises ``UnreadableError`` for other values."""
    array = read_numbers(value)
    if array.size != max(array.shape, default=0):
        raise UnreadableError
    return array.ravel().tolist()


def _column(value: Any) -> Any:
    """Numbers of a row or a column; other values are left to the checks."""
    try:
        return _row(value)
    except UnreadableError:
        return value


def _product(rotation: Any, other: np.ndarray) -> Any:
    """Product of two rotations; what is not a matrix of plausible numbers is left to the checks."""
    try:
        matrix = read_numbers(rotation)
    except UnreadableError:
        return rotation
    return matrix @ other if matrix.shape == (3, 3) and (np.abs(matrix) < _MAX_ENTRY).all() else rotation


def _from_centre(rotation: Any, centre: Any) -> Any:
    """Translation ``-R c`` of a camera with centre c; what is malformed is left to the checks."""
    try:
        matrix, point = read_numbers(rotation), np.array(_row(centre))
    except UnreadableError:
        return centre
    if point.shape != (3,):
        return centre
    if matrix.shape != (3, 3) or not (np.abs(matrix) < _MAX_ENTRY).all():
        return [0.0, 0.0, 0.0]  # so that only the rotation is reported
    return -matrix @ point if (np.abs(point) < _MAX_LENGTH).all() else centre


# Bounds of numbers that are multiplied: a plausible rotation or position is far within.
_MAX_ENTRY, _MAX_LENGTH = 10.0, 1e12
