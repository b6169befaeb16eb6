"""Calibrations in every supported format, valid and damaged."""

import json
import random
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.calibration.write import encode
from pipeline.data import Camera
from tests.hostile.mutations import OF_BYTES, OF_TEXT, spoil


def in_every_format(cameras: Sequence[Camera]) -> Mapping[str, bytes]:
    """The same cameras in all formats, by file name."""
    short = {"convention": "x = K (R X + t)", "cameras": [_short(camera) for camera in cameras]}
    return {
        "cameras.json": encode(cameras),
        "short.json": json.dumps(short, indent=1).encode(),
        "cameras.toml": "\n".join(map(_toml, cameras)).encode(),
        "cameras.qca.txt": _qca(cameras).encode(),
        "cameras.xml": _qca(cameras).encode(),
    }


def spoilt_calibrations(cameras: Sequence[Camera], seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of damaged calibrations: random damage, and special cases."""
    yield from _special(cameras)
    rng = random.Random(seed)  # noqa: S311 - the same each time
    good = in_every_format(cameras)
    for _ in range(count):
        name = rng.choice(sorted(good))
        yield name, spoil(good[name], rng, OF_TEXT if rng.random() < 0.7 else OF_BYTES)


def _special(cameras: Sequence[Camera]) -> Iterator[tuple[str, bytes]]:
    good = in_every_format(cameras)
    yield "cameras.toml", b"x = " + b"1" * 5000
    yield "cameras.xml", b'<?xml version="1.0" encoding="klingon"?><calibration/>'
    yield "cameras.toml", b"".join(b"x%d = 1\n" % number for number in range(100_000))
    yield "cameras.json", good["cameras.json"].replace(b'"name"', _many_fields(50_000) + b'"name"', 1)
    yield "cameras.json", b'{"schema_version": 1, "cameras": [' + b",".join([b"{}"] * 200_000) + b"]}"
    yield "cameras.json", b'{"schema_version": 1, "cameras": [{"\\ud800": 1, "name": "\\ud800"}]}'
    yield "cameras.json", b'{"cameras": [{"K": ["' + b"x" * 1_000_000 + b'"' + b',""' * 100_000 + b"]}]}"
    yield "cameras.xml", b"<calibration><cameras>" + b"<camera/>" * 100_000 + b"</cameras></calibration>"
    yield "cameras.xml", b"<a>" * 300_000


def _many_fields(count: int) -> bytes:
    return b"".join(b'"field %d": 1,' % number for number in range(count))


def _short(camera: Camera) -> dict[str, object]:
    return {
        "name": camera.name,
        "width": camera.size_px[0],
        "height": camera.size_px[1],
        "K": camera.matrix.tolist(),
        "dist": camera.distortion.tolist(),
        "R": camera.cam_from_world.rotation.tolist(),
        "t": camera.cam_from_world.translation_m.tolist(),
    }


def _toml(camera: Camera) -> str:
    values = {
        "name": camera.name,
        "size": list(camera.size_px),
        "matrix": camera.matrix.tolist(),
        "distortions": camera.distortion.tolist(),
        "rotation": Rotation.from_matrix(camera.cam_from_world.rotation).as_rotvec().tolist(),
        "translation": camera.cam_from_world.translation_m.tolist(),
        "fisheye": False,
    }
    return "\n".join([f"[{camera.name}]", *(f"{name} = {json.dumps(value)}" for name, value in values.items()), ""])


def _qca(cameras: Sequence[Camera]) -> str:
    return "\n".join(
        ["<calibration>", " <cameras>", *(_qca_camera(camera) for camera in cameras), " </cameras>", "</calibration>"]
    )


def _qca_camera(camera: Camera) -> str:
    rotation = np.diag([1.0, -1.0, -1.0]) @ camera.cam_from_world.rotation
    center_mm = 1000 * camera.cam_from_world.inverse().translation_m
    matrix = camera.matrix * 64
    distortion = np.zeros(5)
    distortion[: len(camera.distortion)] = camera.distortion[:5]
    names = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
    lens = " ".join(
        f'{name}="{value!r}"' for name, value in zip((*names, "radialDistortion3"), distortion.tolist(), strict=True)
    )
    turn = " ".join(
        f'r{row + 1}{column + 1}="{float(rotation[row, column])!r}"' for row in range(3) for column in range(3)
    )
    place = " ".join(f'{axis}="{value!r}"' for axis, value in zip("xyz", center_mm.tolist(), strict=True))
    return f"""  <camera serial="{camera.name}" model="none">
   <fov_video left="0" right="{camera.size_px[0] - 1}" top="0" bottom="{camera.size_px[1] - 1}"/>
   <transform {place} {turn}/>
   <intrinsic focalLengthU="{float(matrix[0, 0])!r}" focalLengthV="{float(matrix[1, 1])!r}"
    centerPointU="{float(matrix[0, 2])!r}" centerPointV="{float(matrix[1, 2])!r}" skew="0" {lens}/>
  </camera>"""
