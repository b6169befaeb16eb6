"""Calibrations as other programs write them today, valid and damaged."""

import io
import json
import pickle
import random
import zipfile
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.core.data.cameras import Camera
from tests.hostile.calibrations import in_every_format
from tests.hostile.mutations import OF_BYTES, OF_TEXT, spoil

Members = Mapping[str, bytes]

# Whole files that are deep, long, or would grow.
_BOMBS: Mapping[str, bytes] = {
    "aliases.yml": b"%YAML:1.0\n---\na: &a [1, 1]\nb: &b [*a, *a, *a]\nc: [*b, *b, *b]\n",
    "deep.yml": b"%YAML:1.0\n---\nK_a: " + b"[" * 50_000,
    "many.yml": b"%YAML:1.0\n---\n" + b"".join(b"K_%d: [[1]]\n" % number for number in range(50_000)),
    "entities.xml": b'<!DOCTYPE q [<!ENTITY a "1"><!ENTITY b "&a;&a;">]><calibration>&b;</calibration>',
    "many.xml": b"<QTM_Parameters_Ver_1><calibration><cameras>"
    + b'<camera><fov_video left="0" right="9" top="0" bottom="9"/></camera>' * 20_000
    + b"</cameras></calibration></QTM_Parameters_Ver_1>",
    "many.toml": b"[cameras.0]\n" + b"".join(b"field%d = 1\n" % number for number in range(50_000)),
    "deep.json": b'{"a": {"K": ' + b"[" * 20_000,
    "many.json": b'{"s": ['
    + b'{"R": 1, "T": 1, "fx": 1, "fy": 1, "cx": 1, "cy": 1, "k": 1, "p": 1},' * 20_000
    + b"{}]}",
}


def of_programs(cameras: Sequence[Camera]) -> Mapping[str, Members]:
    """Files by the name of their form: one file, or the members of a zip."""
    qca = in_every_format(cameras)["cameras.qca.txt"].decode()
    marker = '<camera serial="11001" model="Oqus"><fov_video left="0" right="0" top="0" bottom="0"/></camera></cameras>'
    metadata = "\n[metadata]\nreprojection_error_px = 0.4\n[metadata.board]\nsquare_length_mm = 58.0\n"
    freemocap = "".join(_toml(f"{k}", camera, 1000.0) for k, camera in enumerate(cameras)) + metadata
    intrinsics, extrinsics = _easymocap(cameras)
    caliscope = "".join(_toml(f"cameras.{k}", camera, 1.0, is_vector=False) for k, camera in enumerate(cameras))
    flat = {camera.name: _association(camera) for camera in cameras}
    return {
        "mixed.qca.txt": {"": qca.replace("</cameras>", marker).encode()},
        "rt.xml": {"": f"<QTM_Parameters_Ver_1.25>\n{qca}\n</QTM_Parameters_Ver_1.25>".encode()},
        "freemocap.toml": {"": freemocap.encode()},
        "anipose.toml": {"": "".join(_toml(f"cam_{k}", camera, 1000.0) for k, camera in enumerate(cameras)).encode()},
        "caliscope.toml": {"": caliscope.encode()},
        "easymocap.zip": {"intri.yml": intrinsics.encode(), "extri.yml": extrinsics.encode()},
        "easymocap.yml": {"": (intrinsics + extrinsics).encode()},
        "jarvis.zip": {f"{camera.name}.yaml": _jarvis(camera).encode() for camera in cameras},
        "association.json": {"": json.dumps(flat, indent=1).encode()},
        "voxelpose.json": {"": json.dumps({"sequence": [_voxelpose(camera) for camera in cameras]}, indent=1).encode()},
        "opencap.zip": {f"{camera.name}.pickle": pickle.dumps(_opencap(camera), 4) for camera in cameras},
    }


def packed(members: Members) -> bytes:
    """Content of a file: the only member without a name, or a zip."""
    if "" in members:
        return members[""]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def spoilt_programs(cameras: Sequence[Camera], seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of damaged files: bombs, then random damage of a file, a member or a zip."""
    rng = random.Random(seed)  # noqa: S311 - the same each time
    good = of_programs(cameras)
    yield from _BOMBS.items()
    for _ in range(count - len(_BOMBS)):
        name = rng.choice(sorted(good))
        members = dict(good[name])
        ways = OF_BYTES if name == "opencap.zip" or rng.random() < 0.3 else OF_TEXT
        if "" not in members and rng.random() < 0.15:
            yield name, spoil(packed(members), rng, OF_BYTES)
            continue
        member = rng.choice(sorted(members))
        members[member] = spoil(members[member], rng, ways)
        yield name, packed(members)


def _toml(title: str, camera: Camera, unit_per_m: float, *, is_vector: bool = True) -> str:
    pose = camera.cam_from_world
    rotation = Rotation.from_matrix(pose.rotation).as_rotvec() if is_vector else pose.rotation
    return f"""
[{title}]
name = "{camera.name}"
id = "{camera.name}"
size = {list(camera.size_px)}
matrix = {camera.matrix.tolist()}
distortions = {camera.distortion.tolist()}
rotation = {rotation.tolist()}
translation = {(unit_per_m * pose.translation_m).tolist()}
verified_resolutions = [[640, 480]]
"""


def _matrix(name: str, matrix: np.ndarray) -> str:
    rows, cols = matrix.shape
    data = ", ".join(map(repr, matrix.ravel().tolist()))
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


def _easymocap(cameras: Sequence[Camera]) -> tuple[str, str]:
    head = "%YAML:1.0\n---\nnames:\n" + "".join(f'   - "{camera.name}"\n' for camera in cameras)
    intrinsics, extrinsics = head + '   - "spare"\n' + _matrix("K_spare", cameras[0].matrix), head
    for camera in cameras:
        name, pose = camera.name, camera.cam_from_world
        intrinsics += _matrix(f"K_{name}", camera.matrix) + _matrix(f"dist_{name}", np.zeros((1, 5)))
        intrinsics += f"H_{name}: {camera.size_px[1]}\nW_{name}: {camera.size_px[0]}\n"
        extrinsics += _matrix(f"Rot_{name}", pose.rotation) + _matrix(f"T_{name}", pose.translation_m.reshape(3, 1))
    return intrinsics, extrinsics


def _jarvis(camera: Camera) -> str:
    pose = camera.cam_from_world
    return "%YAML:1.0\n---\n" + "".join(
        _matrix(name, value)
        for name, value in (
            ("intrinsicMatrix", camera.matrix.T),
            ("distortionCoefficients", np.zeros((1, 5))),
            ("R", pose.rotation.T),
            ("T", 1000.0 * pose.translation_m.reshape(3, 1)),
        )
    )


def _association(camera: Camera) -> dict[str, object]:
    return {
        "K": camera.matrix.ravel().tolist(),
        "RT": camera.cam_from_world.matrix.ravel().tolist(),
        "imgSize": list(camera.size_px),
        "distCoeff": camera.distortion.tolist(),
        "rectifyAlpha": 0.0,
    }


def _voxelpose(camera: Camera) -> dict[str, object]:
    return {
        "R": camera.cam_from_world.rotation.tolist(),
        "T": (1000.0 * camera.cam_from_world.inverse().translation_m).reshape(3, 1).tolist(),
        "fx": float(camera.matrix[0, 0]),
        "fy": float(camera.matrix[1, 1]),
        "cx": float(camera.matrix[0, 2]),
        "cy": float(camera.matrix[1, 2]),
        "k": [[0.0], [0.0], [0.0]],
        "p": [[0.0], [0.0]],
    }


def _opencap(camera: Camera) -> dict[str, object]:
    upright = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return {
        "distortion": np.zeros((1, 5)),
        "intrinsicMat": camera.matrix,
        "imageSize": np.array([[float(side)] for side in camera.size_px[::-1]]),
        "rotation": camera.cam_from_world.rotation @ upright,
        "translation": 1000.0 * camera.cam_from_world.translation_m.reshape(3, 1),
    }
