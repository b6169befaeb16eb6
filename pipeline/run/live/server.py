"""``python -m pipeline.run.live.server``: server from which the processes of live captures are forked.

It has loaded what a capture needs, the compiled kernels too, and waits for requests as ``pipeline.core.runtime.forks``
says. Its programs are ``capture``, which computes a live capture between two pipes (``packets`` describes the
messages; the service checks what clients send and forwards it), and ``calibration``, which checks a stranger's
calibration with the arguments of ``pipeline.capture.preflight``.
"""

import dataclasses
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from pipeline.calibration.registry import read_calibration
from pipeline.capture import preflight
from pipeline.core.data.cameras import Camera
from pipeline.core.data.rigid import Rigid3
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17, MARKED_AT_CENTERS
from pipeline.core.layouts import LAYOUTS, KeypointLayout
from pipeline.core.runtime.forks import serve
from pipeline.detection.entries import find_entry
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.packets import CaptureAnswer, framed, read_message
from pipeline.run.live.packing import described_camera, instant_json, pack_instant, unpack_keypoints
from pipeline.run.live.records import LiveInstant
from pipeline.run.live.settings import LiveSettings

# Lowest score of a point that was found, as in keypoint files.
_MIN_SCORE = 1e-9


@dataclasses.dataclass(slots=True)
class _Run:
    """Live capture, and the form in which its instants are sent."""

    capture: LiveCapture
    layout: KeypointLayout
    is_packed: bool
    send: Callable[[CaptureAnswer, bytes], None]
    sequence: int = 0

    def take(self, packet: bytes) -> None:
        """Compute a packet, and send the instants that are final by it."""
        head, people = unpack_keypoints(packet)
        points_px, score = found_points(people[:, self.layout.indices])
        self._send(self.capture.push(head.camera, head.time_s, points_px, score))
        self.send(CaptureAnswer.TAKEN, self.counts())

    def counts(self) -> bytes:
        """Numbers of frames as JSON."""
        return json.dumps(dataclasses.asdict(self.capture.counts)).encode()

    def end(self) -> None:
        """Send what is held back."""
        self._send(self.capture.flush())
        self.send(CaptureAnswer.END, self.counts())

    def _send(self, instants: Sequence[LiveInstant]) -> None:
        for instant in instants:
            self.send(CaptureAnswer.INSTANT, self._encoded(instant))
            self.sequence += 1

    def _encoded(self, instant: LiveInstant) -> bytes:
        if self.is_packed:
            return pack_instant(instant, len(self.layout.joints.names), len(SKELETON), self.sequence)
        return json.dumps(instant_json(instant, self.sequence), separators=(",", ":")).encode()


def found_points(
    people: Float[np.ndarray, "people joints 3"],
) -> tuple[Float[np.ndarray, "people_found joints 2"], Float[np.ndarray, "people_found joints"]]:
    """Pixels and scores of the people with a point that was found; NaN and 0 where a point was not found."""
    is_found = people[..., 2] >= _MIN_SCORE
    kept = is_found.any(-1)
    people, is_found = people[kept], is_found[kept]
    return np.where(is_found[..., None], people[..., :2], np.nan), np.where(is_found, people[..., 2].clip(0, 1), 0.0)


def _open(start: dict[str, object], send: Callable[[CaptureAnswer, bytes], None]) -> _Run:
    cameras: tuple[Camera, ...] = read_calibration(Path(str(start["calibration"])))
    layout = LAYOUTS[str(start["layout"])]
    network = str(start["joint_centers"])
    offsets = MARKED_AT_CENTERS if network == "off" else find_entry(network).offsets
    capture = LiveCapture(cameras, layout.joints, LiveSettings(**start["settings"]), offsets)  # type: ignore[arg-type]
    ready = {
        "cameras": [camera.name for camera in cameras],
        "joints": layout.joints.names,
        "bones": [joint.name for joint in SKELETON],
        "parents": [joint.parent for joint in SKELETON],
        "rig": [described_camera(camera) for camera in cameras],
    }
    send(CaptureAnswer.READY, json.dumps(ready).encode())
    return _Run(capture, layout, start["format"] == "packed", send)


def run(incoming: BinaryIO, outgoing: BinaryIO) -> int:
    """Compute a live capture until its end; return the exit code."""

    def send(kind: CaptureAnswer, content: bytes) -> None:
        outgoing.write(framed(kind.value + content))
        outgoing.flush()

    start = read_message(incoming)
    if start is None:
        return 0
    try:
        capture = _open(json.loads(start), send)
    except InputError as refused:
        problems = [
            {"code": problem.code, "message": problem.message, "field": problem.field, "camera": problem.camera}
            for problem in refused.problems
        ]
        send(CaptureAnswer.REFUSED, json.dumps(problems).encode())
        return 2
    while (packet := read_message(incoming)) is not None:
        if not packet:
            capture.end()
            break
        capture.take(packet)
    return 0


def main(_: Sequence[str] = ()) -> int:
    """Compute a live capture from stdin to stdout; return the exit code."""
    # Output that a library prints must not come between the answers.
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        return run(sys.stdin.buffer, answers)


_RATE_HZ = 25.0
_LEARN_S = 0.2
_NUM_INSTANTS = 15


def load_kernels() -> None:
    """Load compiled kernels, or compile them: a capture of a person until the bones are learnt and feet are held."""
    body_m = np.random.default_rng(0).uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 1.7], (len(COCO_17.names), 3))
    cameras = [_camera(number) for number in range(3)]
    capture = LiveCapture(cameras, COCO_17, LiveSettings(_RATE_HZ, learn_s=_LEARN_S))
    for instant in range(_NUM_INSTANTS):
        for number, camera in enumerate(cameras):
            capture.push(number, instant / _RATE_HZ, project(camera, body_m)[None], np.ones((1, len(body_m))))


def _camera(number: int) -> Camera:
    """Camera 4 m from the origin, with a distorting lens, 1 m above the floor."""
    cos, sin = np.cos(number), np.sin(number)
    rotation = np.array([[-sin, cos, 0.0], [0.0, 0.0, -1.0], [-cos, -sin, 0.0]])
    matrix = np.array([[800.0, 0.0, 639.5], [0.0, 800.0, 359.5], [0.0, 0.0, 1.0]])
    translation_m = np.array([0.0, 1.0, 4.0])
    return Camera(f"cam{number}", (1280, 720), matrix, np.array([-0.1, 0.0, 0.0, 0.0]), Rigid3(rotation, translation_m))


if __name__ == "__main__":
    load_kernels()
    serve({"capture": main, "calibration": preflight.main})
