"""``python -m pipeline.run.live.cameras.program``: a live capture from cameras, for the service.

Messages go over stdin and stdout as ``pipeline.run.live.packets`` says. The start is an object with ``calibration``,
the path of a file in metres, Z up; ``sources``, the fields of a ``CameraSource`` each; ``choices`` of the networks;
``sync_s``; addresses of ``outputs``; ``format`` of the instants; and ``keep``, with which the file gets the cameras of
the keypoints. Without ``sources`` a simulated person is captured, and ``outputs`` and ``format`` suffice. The capture
ends when stdin is closed.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, PipelineError
from pipeline.core.joints import BODY_FEET, COCO_17, COCO_18, JointSet
from pipeline.core.layouts import LAYOUTS, KeypointLayout
from pipeline.core.options.config import MotionChoices
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.cameras.listeners import OutputListener, PatternRun, StatusFigures, capture, ready_document
from pipeline.run.live.cameras.run import CameraRun, LiveListener
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.cameras.totals import LiveTotals
from pipeline.run.live.outputs.runner import LiveOutputs
from pipeline.run.live.packets import CaptureAnswer, framed, read_message
from pipeline.run.live.packing import instant_json, pack_instant, pack_keypoints
from pipeline.run.live.records import DetectedFrame, LiveInstant

_LAYOUTS = {COCO_17: "coco-17", COCO_18: "coco-18", BODY_FEET: "halpe-26"}


def layout_of(joints: JointSet) -> KeypointLayout:
    """Layout of messages with the points of a network."""
    return LAYOUTS[_LAYOUTS.get(joints, "coco-wholebody-133")]


class _Answers(LiveListener):
    """Answers of the process: the capture as the service passes it on."""

    def __init__(self, outgoing: BinaryIO, is_packed: bool, kept: Path | None) -> None:
        self._outgoing, self._is_packed, self._kept = outgoing, is_packed, kept
        self.outputs = LiveListener()
        self._figures = StatusFigures()
        self._places: dict[str, int] = {}
        self._layout = LAYOUTS["coco-17"]
        self._sequence = 0

    def send(self, kind: CaptureAnswer, content: bytes) -> None:
        self._outgoing.write(framed(kind.value + content))
        self._outgoing.flush()

    def send_json(self, kind: CaptureAnswer, content: Any) -> None:
        self.send(kind, json.dumps(content, separators=(",", ":")).encode())

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        self._layout = layout_of(joints)
        self._places = {camera.name: place for place, camera in enumerate(cameras)}
        if self._kept is not None:  # keypoints are in pixels of the pictures, to which the cameras were fitted
            self._kept.write_bytes(encode(cameras))
        self.outputs.begin(cameras, joints, frame_rate_hz)
        self.send_json(
            CaptureAnswer.READY, ready_document(cameras, joints, frame_rate_hz) | {"layout": self._layout.name}
        )

    def take(self, camera: Camera, frame: DetectedFrame) -> None:
        if self._kept is None:
            return
        shape = len(frame.score), len(self._layout.points)
        points_px, score = np.full((*shape, 2), np.nan), np.zeros(shape)
        points_px[:, self._layout.indices], score[:, self._layout.indices] = frame.points_px, frame.score
        self.send(CaptureAnswer.KEPT, pack_keypoints(self._places[camera.name], frame.time_s, points_px, score))

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        self.outputs.show(instant, latency_s)
        self._figures.add(latency_s)
        num_joints = len(self._layout.joints.names)
        if self._is_packed:
            content = pack_instant(instant, num_joints, len(SKELETON), self._sequence)
        else:
            content = json.dumps(instant_json(instant, self._sequence), separators=(",", ":")).encode()
        self.send(CaptureAnswer.INSTANT, content)
        self._sequence += 1

    def tell(self, sentence: str) -> None:
        self.send_json(CaptureAnswer.TOLD, {"type": "notice", "message": sentence})

    def tick(self, totals: LiveTotals) -> None:
        self.send_json(CaptureAnswer.TOLD, self._figures.message(totals))

    def end(self, totals: LiveTotals) -> None:
        decoded = sum(camera.decoded for camera in totals.cameras)
        detected = sum(camera.detected for camera in totals.cameras)
        counts = {"received": decoded, "taken": detected, "late": 0, "dropped": max(0, decoded - detected)}
        self.send_json(CaptureAnswer.END, counts)


def run(incoming: BinaryIO, outgoing: BinaryIO) -> int:
    """Compute a live capture from cameras until its end; return the exit code."""
    if (content := read_message(incoming)) is None:
        return 0
    start = json.loads(content)
    kept = Path(start["calibration"]) if start.get("keep") else None
    answers = _Answers(outgoing, start["format"] == "packed", kept)
    try:
        _capture(start, answers, incoming)
    except InputError as refused:
        answers.send_json(CaptureAnswer.REFUSED, [asdict(problem) for problem in refused.problems])
        return 2
    except PipelineError as failed:
        answers.send_json(CaptureAnswer.REFUSED, [{"code": failed.code, "message": str(failed)}])
        return 2
    return 0


def _capture(start: dict[str, Any], answers: _Answers, incoming: BinaryIO) -> None:
    with LiveOutputs(start["outputs"], allow_network=True) as outputs:
        capture, execute = _prepared(start, answers)
        answers.outputs = OutputListener(outputs, capture.totals)

        def stop_at_end() -> None:
            read_message(incoming)
            capture.stop()

        threading.Thread(target=stop_at_end, daemon=True).start()
        execute()
        answers.end(capture.totals)


def _prepared(start: dict[str, Any], answers: _Answers) -> tuple[CameraRun | PatternRun, Callable[[], None]]:
    """Capture of the cameras, or of a simulated person, and the function that runs it."""
    if "sources" not in start:
        pattern = PatternRun(answers)
        return pattern, pattern.run
    choices = MotionChoices(**start["choices"])
    sources = [CameraSource(**source) for source in start["sources"]]
    cameras = {camera.name: camera for camera in read_calibration(Path(start["calibration"]))}
    filmed = CameraRun([cameras[source.camera] for source in sources], sources, choices, answers, start["sync_s"])
    return filmed, partial(capture, filmed, choices)


def main() -> int:
    """Compute a live capture from stdin to stdout; return the exit code."""
    # Output that a library prints must not come between the answers.
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        return run(sys.stdin.buffer, answers)


if __name__ == "__main__":
    sys.exit(main())
