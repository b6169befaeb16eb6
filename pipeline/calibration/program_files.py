"""Write cameras for other programs: Qualisys, OpenCap, EasyMocap, FreeMoCap, COLMAP, Kalibr and MAMMA.

A lens that a format can't hold is refused. OpenCap's world has y down, and every file but QCA, OpenCap's and
FreeMoCap's is in metres.
"""

import io
import json
import pickle
import re
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from pipeline.calibration import write
from pipeline.calibration.contents import scaled
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import Problem
from pipeline.core.problems.session_codes import INVALID_NAME, UNSUPPORTED_LENS
from pipeline.geometry.camera import center_in_world

_CV_FROM_QUALISYS = np.diag([1.0, -1.0, -1.0])
_SUBPIXELS = 64
# From OpenCap's world, of a board that stands upright, to Z up: x, y down, z to the back.
_UPRIGHT_FROM_OPENCAP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Earliest date of a zip: equal cameras give equal bytes.
_DATE = (1980, 1, 1, 0, 0, 0)


def encode_qca(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as Qualisys writes them: 64ths of a pixel, millimetres, y up and z backwards in the camera."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<calibration type="regular">', "<cameras>"]
    for camera in cameras:
        width, height = camera.size_px
        area = f'left="0" top="0" right="{width - 1}" bottom="{height - 1}"'
        k1, k2, p1, p2, k3 = _padded(camera, 5)
        x, y, z = (1000 * center_in_world(camera)).tolist()
        turn = (_CV_FROM_QUALISYS @ camera.cam_from_world.rotation).tolist()
        turns = (f'r{row + 1}{column + 1}="{turn[row][column]!r}"' for row in range(3) for column in range(3))
        (fx, _, cx), (_, fy, cy), _ = (_SUBPIXELS * camera.matrix).tolist()
        name = quoteattr(camera.name)
        lines += [
            f'<camera active="1" calibrated="true" point-count="0" avg-residual="0" serial={name} model="Miqus Video" '
            'viewrotation="0">',
            *(f"<{tag} {area}/>" for tag in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max")),
            f'<transform x="{x!r}" y="{y!r}" z="{z!r}" {" ".join(turns)}/>',
            f'<intrinsic focallength="0" sensorMinU="0" sensorMaxU="{_SUBPIXELS * width}" sensorMinV="0" '
            f'sensorMaxV="{_SUBPIXELS * height}" focalLengthU="{fx!r}" focalLengthV="{fy!r}" centerPointU="{cx!r}" '
            f'centerPointV="{cy!r}" skew="0" radialDistortion1="{k1!r}" radialDistortion2="{k2!r}" '
            f'radialDistortion3="{k3!r}" tangentalDistortion1="{p1!r}" tangentalDistortion2="{p2!r}"/>',
            "</camera>",
        ]
    return "\n".join([*lines, "</cameras>", "</calibration>", ""]).encode()


def encode_opencap(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as OpenCap's ``cameraIntrinsicsExtrinsics.pickle`` of each camera, in a zip."""
    members = {}
    for camera in cameras:
        rotation = camera.cam_from_world.rotation @ _UPRIGHT_FROM_OPENCAP
        document = {
            "distortion": np.array([_padded(camera, max(5, len(camera.distortion)))]),
            "intrinsicMat": np.array(camera.matrix),
            "imageSize": np.array([[float(side)] for side in camera.size_px[::-1]]),
            "rotation": rotation,
            "translation": 1000 * camera.cam_from_world.translation_m[:, None],
            "rotation_EulerAngles": write.rotation_of(rotation).as_rotvec()[:, None],
        }
        # NumPy 1, which OpenCap uses, has no module of NumPy 2's name; NumPy 2 knows the older name.
        content = pickle.dumps(document, protocol=3).replace(b"numpy._core", b"numpy.core")
        members[f"{camera.name}/cameraIntrinsicsExtrinsics.pickle"] = content
    return _zip(members)


def encode_easymocap(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as EasyMocap's ``intri.yml`` and ``extri.yml``, in a zip."""
    head = ["%YAML:1.0", "---", "names:", *(f'   - "{camera.name}"' for camera in cameras)]
    intrinsics, extrinsics = list(head), list(head)
    for camera in cameras:
        name, pose = camera.name, camera.cam_from_world
        distortion = _padded(camera, max(5, len(camera.distortion)))
        intrinsics += [*_storage(f"K_{name}", camera.matrix), *_storage(f"dist_{name}", np.array([distortion]))]
        intrinsics += [f"{side}_{name}: {length}" for side, length in zip("WH", camera.size_px, strict=True)]
        extrinsics += _storage(f"R_{name}", write.rotation_of(pose.rotation).as_rotvec()[:, None])
        extrinsics += [*_storage(f"Rot_{name}", pose.rotation), *_storage(f"T_{name}", pose.translation_m[:, None])]
    files = {"intri.yml": intrinsics, "extri.yml": extrinsics}
    return _zip({name: "\n".join([*lines, ""]).encode() for name, lines in files.items()})


def _storage(key: str, matrix: np.ndarray) -> list[str]:
    return write.storage_matrix(key, matrix.tolist(), indent=0)


def encode_freemocap(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as FreeMoCap's TOML: anipose's, in millimetres, with ``[metadata]``."""
    text = write.encode_toml([scaled(camera, 1000.0) for camera in cameras]).decode()
    return f'{text}\n[metadata]\nunits = "mm"\ngroundplane_calibration = true\n'.encode()


def encode_colmap(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as COLMAP's text model, in a zip: an image ``NAME.png`` of each camera, and no points."""
    lenses = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
    ]
    for number, camera in enumerate(cameras, 1):
        (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
        model, length = "OPENCV_FISHEYE", 4
        if camera.lens == "standard":
            length = next(count for count in (0, 4, 8) if not camera.distortion[count:].any())
            model = {0: "PINHOLE", 4: "OPENCV", 8: "FULL_OPENCV"}[length]
        # COLMAP's pixel (0, 0) is the outer corner of the first pixel.
        lens = _words([fx, fy, cx + 0.5, cy + 0.5, *_padded(camera, length)])
        pose = _words(
            [
                *np.roll(write.rotation_of(camera.cam_from_world.rotation).as_quat(), 1),
                *camera.cam_from_world.translation_m,
            ]
        )
        lenses.append(f"{number} {model} {camera.size_px[0]} {camera.size_px[1]} {lens}")
        images += [f"{number} {pose} {number} {camera.name}.png", ""]
    points = "# 3D point list with one line of data per point:\n"
    files = {"cameras.txt": lenses, "images.txt": images}
    return _zip(
        {name: "\n".join([*lines, ""]).encode() for name, lines in files.items()} | {"points3D.txt": points.encode()}
    )


def encode_kalibr(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as Kalibr's chain; ``T_cam_imu`` is the transform from the world, and names are ``rostopic``."""
    lines = []
    for number, camera in enumerate(cameras):
        lines += [
            f"cam{number}:",
            *_lens_lines(camera, "  "),
            f"  rostopic: {json.dumps(f'/{camera.name}', ensure_ascii=False)}",
        ]
        lines += _transform_lines("T_cam_imu", camera.cam_from_world)
        if number:
            lines += _transform_lines("T_cn_cnm1", camera.cam_from_world @ cameras[number - 1].cam_from_world.inverse())
    return "\n".join([*lines, ""]).encode()


def encode_mamma(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as MAMMA's YAML: the pose of each camera in the world."""
    lines = ["extrinsics_convention: cam2world", "quaternion_order: wxyz", "cameras:"]
    for camera in cameras:
        pose = camera.cam_from_world.inverse()
        lines += [
            f"  {json.dumps(camera.name, ensure_ascii=False)}:",
            *_lens_lines(camera, "    "),
            f"    translation: {json.dumps(pose.translation_m.tolist())}",
            f"    rotation_quaternion: {json.dumps(np.roll(write.rotation_of(pose.rotation).as_quat(), 1).tolist())}",
        ]
    return "\n".join([*lines, ""]).encode()


def _lens_lines(camera: Camera, indent: str) -> list[str]:
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    fields = {
        "camera_model": "pinhole",
        "distortion_model": "equidistant" if camera.lens == "fisheye" else "radtan",
        "intrinsics": [fx, fy, cx, cy],
        "distortion_coeffs": _padded(camera, 4),
        "resolution": list(camera.size_px),
    }
    return [
        f"{indent}{name}: {value if isinstance(value, str) else json.dumps(value)}" for name, value in fields.items()
    ]


def _transform_lines(name: str, pose: Rigid3) -> list[str]:
    rows = [*pose.matrix.tolist(), [0.0, 0.0, 0.0, 1.0]]
    return [f"  {name}:", *(f"  - {json.dumps(row)}" for row in rows)]


def _padded(camera: Camera, length: int) -> list[float]:
    """So many coefficients: zeros for missing ones; ``refusals`` has none beyond."""
    return [*camera.distortion.tolist(), *[0.0] * length][:length]


def _words(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _zip(members: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content)
    return buffer.getvalue()


class ProgramFormat(NamedTuple):
    """Format of a program, and the lenses and names that it holds."""

    title: str
    endings: tuple[str, ...]  # Endings of its files, the usual one first
    encode: Callable[[Sequence[Camera]], bytes]
    max_coefficients: int = 12
    has_fisheye: bool = True
    has_skew: bool = True
    names: str = ".+"  # Regular expression of the names of cameras


PROGRAM_FORMATS: Mapping[str, ProgramFormat] = {
    "multicap": ProgramFormat("Multicap's JSON", (".json",), write.encode),
    "anipose": ProgramFormat("anipose's TOML", (".toml",), write.encode_toml),
    "caliscope": ProgramFormat("Caliscope's TOML", (".toml",), write.encode_caliscope),
    "opencv": ProgramFormat("OpenCV's YAML", (".yml", ".yaml"), write.encode_opencv),
    "freemocap": ProgramFormat("FreeMoCap's TOML", (".toml",), encode_freemocap),
    "qca": ProgramFormat("Qualisys QCA", (".qca.txt", ".qca", ".xml"), encode_qca, 5, False, False),
    "opencap": ProgramFormat("OpenCap's pickles", (".zip",), encode_opencap, 12, False, False, "[^.].*"),
    "easymocap": ProgramFormat("EasyMocap's YAML", (".zip",), encode_easymocap, 12, False, False, "[A-Za-z0-9_-]+"),
    "colmap": ProgramFormat("COLMAP's text", (".zip",), encode_colmap, 8, True, False, r"\S+"),
    "kalibr": ProgramFormat("Kalibr's YAML", (".yaml", ".yml"), encode_kalibr, 4, True, False),
    "mamma": ProgramFormat("MAMMA's YAML", (".yaml", ".yml"), encode_mamma, 4, False, False),
}
"""Formats that are written, by name; the first one of an ending is its usual format."""


def refusals(name: str, cameras: Sequence[Camera], file: str) -> list[Problem]:
    """Problems of cameras that a format can't hold: its lens model, or the characters of its names."""
    target = PROGRAM_FORMATS[name]
    problems = []
    for camera in cameras:
        is_fisheye, num_used = camera.lens == "fisheye", len(np.trim_zeros(camera.distortion, "b"))
        reasons = {
            "a fisheye lens": is_fisheye and not target.has_fisheye,
            f"{num_used} coefficients of distortion, but {target.max_coefficients}": not is_fisheye
            and num_used > target.max_coefficients,
            "axes of pixels that are not at a right angle (skew)": bool(camera.matrix[0, 1]) and not target.has_skew,
        }
        for reason in (reason for reason, holds in reasons.items() if holds):
            message = f"{target.title} can't hold {reason}."
            hint = "Choose another format, such as multicap or opencv, or undistort the videos."
            problems.append(Problem(UNSUPPORTED_LENS, message, file, camera.name, "distortion", hint))
        if not re.fullmatch(target.names, camera.name):
            message = f"{target.title} can't hold this name."
            hint = "Rename the camera: letters A to Z, digits, _ and - serve."
            problems.append(Problem(INVALID_NAME, message, file, camera.name, "name", hint))
    return problems
