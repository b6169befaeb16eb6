"""Calibrations in every supported format, valid and damaged."""

import json
import pickle
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.calibration.program_files import encode_kalibr, encode_mamma
from pipeline.calibration.write import encode, encode_caliscope, encode_opencv, encode_toml
from pipeline.core.data.cameras import Camera
from tests.hostile.mutations import OF_BYTES, OF_TEXT, spoil


def in_every_format(cameras: Sequence[Camera]) -> Mapping[str, bytes]:
    """The same cameras in all formats, by file name."""
    fisheyes = [replace(camera, distortion=np.array([0.03, -0.01, 0.0, 0.0]), lens="fisheye") for camera in cameras]
    short = {"convention": "x = K (R X + t)", "cameras": [_short(camera) for camera in cameras]}
    return {
        "cameras.json": encode(cameras),
        "short.json": json.dumps(short, indent=1).encode(),
        "cameras.toml": encode_toml(cameras),
        "camera_array.toml": encode_caliscope(cameras),
        "cameras.yml": encode_opencv(cameras),
        "panoptic.json": json.dumps({"cameras": [_panoptic(camera) for camera in cameras]}, indent=1).encode(),
        "mamma.yaml": encode_mamma(cameras),
        "camchain.yaml": encode_kalibr(fisheyes),
        "human36m.json": json.dumps(_human36m(cameras), indent=1).encode(),
        "cameras.xcp": f"<Cameras>{''.join(map(_xcp, cameras))}</Cameras>".encode(),
        "colmap.txt": _colmap(cameras).encode(),
        "cameras.qca.txt": _qca(cameras).encode(),
        "cameras.xml": _qca(cameras).encode(),
        "cameras.mcal": f"<calibrationProfile>{_mcal(cameras)}</calibrationProfile>".encode(),
        "fisheye.json": encode(fisheyes),
        "fisheye.toml": encode_toml(fisheyes),
        "fisheye.yml": encode_opencv(fisheyes),
    }


def pickles(cameras: Sequence[Camera]) -> Mapping[str, bytes]:
    """Pickles of OpenCap (one camera) and of MVPose (all cameras, without sizes), by file name."""
    one = cameras[0]
    opencap = {
        "intrinsicMat": one.matrix,
        "distortion": np.zeros((1, 5)),
        "imageSize": np.array(one.size_px[::-1], dtype=float).reshape(2, 1),
        "rotation": one.cam_from_world.rotation,
        "translation": one.cam_from_world.translation_m.reshape(3, 1),
    }
    mvpose = {
        "K": np.stack([camera.matrix for camera in cameras]),
        "RT": np.stack([camera.cam_from_world.matrix for camera in cameras]),
    }
    return {
        f"{name}{protocol}.pickle": pickle.dumps(document, protocol)
        for name, document in (("opencap", opencap), ("camera_parameter", mvpose))
        for protocol in (3, 4, 5)
    }


def spoilt_calibrations(cameras: Sequence[Camera], seed: int, count: int) -> Iterator[tuple[str, bytes]]:
    """Name and content of damaged calibrations: random damage, and special cases."""
    yield from _special(cameras)
    rng = random.Random(seed)  # noqa: S311 - the same each time
    good = {**in_every_format(cameras), **pickles(cameras)}
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
    yield "cameras.yml", b"a: " + b"[" * 1_000_000
    yield "cameras.yml", b"a: [" + b"1," * 2_000_000
    yield "cameras.yml", b"".join(b"a%d: {K: [[1]]}\n" % number for number in range(100_000))
    yield "cameras.yml", b"a: &a [1]\nb: &b [*a, *a]\nc: [*b, *b]\n"
    yield "cameras.xml", b"<opencv_storage>" + b"<a>" * 300_000
    yield "cameras.xcp", b"<Cameras>" + b"<Camera><KeyFrames><KeyFrame/></KeyFrames></Camera>" * 50_000 + b"</Cameras>"
    yield "cameras.mcal", b"<calibrationProfile><Calibration><Cameras>" + b"<Camera/>" * 50_000
    yield "evil.pickle", b"\x80\x04\x8c\x05posix\x8c\x06system\x93\x8c\x0etouch /tmp/evil\x85R."
    yield "huge.pickle", b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x0f"
    yield "long.pickle", b"\x80\x04" + b"]" * 1_000_000 + b"."
    yield "colmap.txt", good["colmap.txt"] + b"1 1 0 0 0 0 0 0 1 a.png\n\n" * 100_000


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


def _panoptic(camera: Camera) -> dict[str, object]:
    pose = camera.cam_from_world
    return {
        "name": camera.name,
        "type": "hd",
        "resolution": list(camera.size_px),
        "K": camera.matrix.tolist(),
        "distCoef": camera.distortion.tolist(),
        "R": pose.rotation.tolist(),
        "t": (100.0 * pose.translation_m).reshape(3, 1).tolist(),
    }


def _human36m(cameras: Sequence[Camera]) -> dict[str, object]:
    poses = {camera.name: camera.cam_from_world for camera in cameras}
    return {
        "intrinsics": {
            camera.name: {"calibration_matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist()}
            for camera in cameras
        },
        "extrinsics": {
            "S1": {
                name: {"R": pose.rotation.tolist(), "t": (1000.0 * pose.translation_m).reshape(3, 1).tolist()}
                for name, pose in poses.items()
            }
        },
    }


def _words(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))


def _xcp(camera: Camera) -> str:
    quaternion = Rotation.from_matrix(camera.cam_from_world.rotation).as_quat()
    center_mm = 1000 * camera.cam_from_world.inverse().translation_m
    return f"""<Camera DEVICEID="{camera.name}" SENSOR_SIZE="{camera.size_px[0]} {camera.size_px[1]}" TYPE="Video">
<KeyFrames><KeyFrame FOCAL_LENGTH="{float(camera.matrix[0, 0])!r}" PRINCIPAL_POINT="{_words(camera.matrix[:2, 2])}"
ORIENTATION="{_words(quaternion)}" POSITION="{_words(center_mm)}" VICON_RADIAL="1e-8 0"/></KeyFrames></Camera>
"""


def _colmap(cameras: Sequence[Camera]) -> str:
    lenses = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"]
    for k, camera in enumerate(cameras):
        width, height = camera.size_px
        lens = np.array([camera.matrix[0, 0], camera.matrix[1, 1], *camera.matrix[:2, 2]])
        quaternion = np.roll(Rotation.from_matrix(camera.cam_from_world.rotation).as_quat(), 1)
        lenses.append(f"{k} PINHOLE {width} {height} {_words(lens)}")
        pose = _words(np.concatenate([quaternion, camera.cam_from_world.translation_m]))
        images += [f"{k} {pose} {k} {camera.name}.png", ""]
    return "\n".join([*lenses, *images, ""])


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


def _mcal(cameras: Sequence[Camera]) -> str:
    return f"<Calibration><Cameras>{''.join(map(_mcal_camera, cameras))}</Cameras></Calibration>"


def _mcal_camera(camera: Camera) -> str:
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    turned = (camera.cam_from_world.rotation.T @ np.diag([1.0, -1.0, -1.0])).ravel().tolist()
    orientation = " ".join(f'OrientMatrix{k}="{value}"' for k, value in enumerate(turned))
    return (
        f'<Camera Serial="{camera.name}"><Properties ImagerIndex="30"/>\n'
        f'<Attributes ImagerPixelWidth="{camera.size_px[0]}" ImagerPixelHeight="{camera.size_px[1]}"/>\n'
        f'<IntrinsicStandardCameraModel LensCenterX="{cx}" LensCenterY="{cy}" HorizontalFocalLength="{fx}"\n'
        f' VerticalFocalLength="{fy}" k1="0" k2="0" k3="0" TangentialX="0" TangentialY="0"/>\n'
        f'<Extrinsic X="1" Y="2" Z="3" {orientation}/></Camera>\n'
    )
