"""Write cameras: Multicap's own JSON, TOML of anipose and Caliscope, OpenCV's YAML; ``registry`` reads all of them.

The programs want five numbers of distortion, zeros for a lens that has none.
"""

import itertools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pipeline.calibration.contents import UNKNOWN_SIZE
from pipeline.calibration.readers.json_formats import SCHEMA_VERSION
from pipeline.core.data.cameras import Camera


def encode(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras with every digit of their numbers; equal cameras give equal bytes."""
    return (json.dumps(_document(cameras), indent=1, allow_nan=False) + "\n").encode()


def _document(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Cameras as a JSON object of Multicap's own format; ``size_px`` is null for an unknown size."""
    return {
        "schema_version": SCHEMA_VERSION,
        "cameras": [
            {
                "name": camera.name,
                "size_px": None if camera.size_px == UNKNOWN_SIZE else list(camera.size_px),
                "matrix": camera.matrix.tolist(),
                "distortion": camera.distortion.tolist(),
                "rotation": camera.cam_from_world.rotation.tolist(),
                "translation_m": camera.cam_from_world.translation_m.tolist(),
            }
            # Other cameras keep the form of earlier versions.
            | ({"lens": camera.lens} if camera.lens != "standard" else {})
            for camera in cameras
        ],
    }


def encode_toml(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as anipose writes them, in metres; the sections are ``cam_0``, ``cam_1``, ...

    aniposelib sorts the sections as text, so that all numbers have the same length: ``cam_02`` is before ``cam_10``.
    """
    num_digits = len(str(len(cameras) - 1))
    return "\n".join(
        _section(f"cam_{number:0{num_digits}}", _fields(camera)) for number, camera in enumerate(cameras)
    ).encode()


def encode_caliscope(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as Caliscope's ``camera_array.toml``, in metres; the sections are ``cameras.0``, ...

    Caliscope itself ignores the names.
    """
    return "\n".join(
        _section(f"cameras.{number}", {"cam_id": number, **_fields(camera), "rotation_count": 0})
        for number, camera in enumerate(cameras)
    ).encode()


def encode_opencv(cameras: Sequence[Camera]) -> bytes:
    """Encode cameras as YAML of OpenCV's FileStorage: a mapping of cameras, in metres.

    OpenCV reads no file with a key such as ``01``: a camera of such a name has the key ``camera_0`` or alike, and a
    field ``name``.
    """
    keys = {camera.name for camera in cameras if _KEY.fullmatch(camera.name)}
    lines = ["%YAML:1.0", "---"]
    for number, camera in enumerate(cameras):
        key = camera.name
        if key not in keys:
            key = next(key for count in itertools.count(number) if (key := f"camera_{count}") not in keys)
            keys.add(key)
        lines += _mapping(key, camera)
    return "\n".join([*lines, ""]).encode()


ENCODERS: Mapping[str, Callable[[Sequence[Camera]], bytes]] = {
    ".json": encode,
    ".toml": encode_toml,
    ".yml": encode_opencv,
    ".yaml": encode_opencv,
}
"""Encoder by the ending of the file."""


# Names that are keys for OpenCV and for our reader, which looks for a list or a mapping under ``cameras``.
_KEY = re.compile(r"(?!cameras$)[A-Za-z_][A-Za-z0-9_-]*")


def rotation_of(matrix: Any) -> Any:
    """Rotation of SciPy by its matrix."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import, and seldom needed

    return Rotation.from_matrix(matrix)


def _rotation_vector(camera: Camera) -> list[float]:
    return list(rotation_of(camera.cam_from_world.rotation).as_rotvec().tolist())


def _coefficients(camera: Camera) -> list[float]:
    """Distortion with zeros in place of missing coefficients up to k3; a fisheye lens has four."""
    coefficients: list[float] = camera.distortion.tolist()
    return coefficients + [0.0] * (5 - len(coefficients)) if camera.lens == "standard" else coefficients


def _fields(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "size": list(camera.size_px),
        "matrix": camera.matrix.tolist(),
        "distortions": _coefficients(camera),
        "rotation": _rotation_vector(camera),
        "translation": camera.cam_from_world.translation_m.tolist(),
        "fisheye": camera.lens == "fisheye",
    }


def _section(title: str, fields: Mapping[str, Any]) -> str:
    # JSON's texts, numbers and lists are TOML's, too, but for surrogates.
    return "\n".join([f"[{title}]", *(f"{name} = {_value(value)}" for name, value in fields.items()), ""])


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


def _mapping(key: str, camera: Camera) -> list[str]:
    vectors = {
        "distortion_coefficients": _coefficients(camera),
        "rvec": _rotation_vector(camera),
        "tvec": camera.cam_from_world.translation_m.tolist(),
    }
    return [
        f"{key}:",
        *([f"   name: {_value(camera.name)}"] if key != camera.name else []),
        f"   image_width: {camera.size_px[0]}",
        f"   image_height: {camera.size_px[1]}",
        *(["   camera_model: fisheye"] if camera.lens == "fisheye" else []),
        *storage_matrix("camera_matrix", camera.matrix.tolist()),
        *(line for name, numbers in vectors.items() for line in storage_matrix(name, [[number] for number in numbers])),
    ]


def storage_matrix(name: str, rows: list[list[float]], indent: int = 3) -> list[str]:
    """Lines of a matrix in OpenCV's FileStorage."""
    data = ", ".join(repr(number) for row in rows for number in row)
    fields = {"rows": len(rows), "cols": len(rows[0]), "dt": "d", "data": f"[ {data} ]"}
    return [
        f"{' ' * indent}{name}: !!opencv-matrix",
        *(f"{' ' * (indent + 3)}{field}: {value}" for field, value in fields.items()),
    ]
