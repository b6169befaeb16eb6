"""Sessions of keypoints as files of the service, valid and damaged."""

import io
import json
import random
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace

from pipeline.validation.simulation.scenes import Simulation, find_scene, record, simulation_files
from tests.hostile.mutations import NUMBERS, OF_BYTES, OF_TEXT, spoil

_NAMES = (
    "../../frame_000000000001_keypoints.json",
    "frame_999999999999999_keypoints.json",
    "frame_1\n2_keypoints.json",
    "\u202egnp_000000000003_keypoints.json",
    "x" * 250 + "_keypoints.json",
    "a/b/c/frame_000000000001_keypoints.json",
    ".json",
    "frame_\u0661_keypoints.json",
)


def simulate(num_views: int = 2, duration_s: float = 0.3) -> Simulation:
    """Small simulation."""
    return record(replace(find_scene("unsynchronised"), duration_s=duration_s), seed=4, num_views=num_views)


def keypoint_files(simulation: Simulation) -> dict[str, bytes]:
    """Calibration, timestamps, and an archive for each camera."""
    files = dict(simulation_files(simulation))
    frames: dict[str, dict[str, bytes]] = {}
    for name, content in files.items():
        if name.startswith("keypoints/"):
            _, camera, frame = name.split("/")
            frames.setdefault(camera, {})[frame] = content
    archives = {f"{camera}.zip": archive(of_camera) for camera, of_camera in frames.items()}
    return {name: files[name] for name in ("calibration.json", "timestamps.csv")} | archives


def archive(files: Mapping[str, bytes]) -> bytes:
    """Zip archive of files."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as entries:
        for name, data in files.items():
            entries.writestr(name, data)
    return content.getvalue()


def spoilt_keypoints(simulation: Simulation, seed: int, count: int) -> Iterator[dict[str, bytes]]:
    """Files of damaged sessions: random damage, and special cases."""
    good = keypoint_files(simulation)
    yield from _special(good)
    rng = random.Random(seed)  # noqa: S311 - the same each time
    first = next(name for name in good if name.endswith(".zip"))
    for _ in range(count):
        match rng.randrange(4):
            case 0:
                yield good | {first: spoil(good[first], rng, OF_BYTES)}
            case 1:
                yield good | {
                    "timestamps.csv": spoil(good["timestamps.csv"], rng, OF_TEXT if rng.random() < 0.7 else OF_BYTES)
                }
            case 2:
                frames = _frames(good[first])
                frame = rng.choice(sorted(frames))
                frames[frame] = spoil(frames[frame], rng, OF_TEXT if rng.random() < 0.8 else OF_BYTES)
                yield good | {first: archive(frames)}
            case _:
                frames = _frames(good[first])
                frames[rng.choice(_NAMES)] = frames[sorted(frames)[0]]
                yield good | {first: archive(frames)}


def _special(good: Mapping[str, bytes]) -> Iterator[dict[str, bytes]]:
    first = next(name for name in good if name.endswith(".zip"))
    cameras = [name.removesuffix(".zip") for name in good if name.endswith(".zip")]
    frame = sorted(_frames(good[first]))[0]
    for value in NUMBERS:
        person = b'{"pose_keypoints_2d": [' + b",".join([value] * 51) + b"]}"
        yield dict(good) | {first: archive(_frames(good[first]) | {frame: b'{"people": [' + person + b"]}"})}
        rows = b"".join(
            b"%s,%d,%s\n" % (camera.encode(), number, value if number == 1 else b"0.%d" % number)
            for camera in cameras
            for number in range(20)
        )
        yield dict(good) | {"timestamps.csv": b"camera,frame,time_s\n" + rows}
    tiny = b"".join(
        b"%s,%d,%d%s\n" % (camera.encode(), number, number, b"e-320") for camera in cameras for number in range(20)
    )
    yield dict(good) | {"timestamps.csv": b"camera,frame,time_s\n" + tiny}
    yield dict(good) | {first: archive({frame: json.dumps({"people": [{"pose_keypoints_2d": ["1"] * 51}]}).encode()})}
    yield dict(good) | {first: archive({frame: json.dumps({"people": [{"pose_keypoints_2d": [True] * 51}]}).encode()})}


def _frames(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as entries:
        return {name: entries.read(name) for name in entries.namelist()}
