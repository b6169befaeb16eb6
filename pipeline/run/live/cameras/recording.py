"""``python -m pipeline.run.live.cameras.recording``: record cameras for a moment, for the service.

Messages go over stdin and stdout as ``pipeline.run.live.packets`` says. The start is an object with ``sources``, the
fields of a ``CameraSource`` each; ``duration_s``, counted from the time at which all cameras are open; and ``folder``,
which gets a video of each camera, ``0.mkv`` and so on. The end has ``offsets_s``, the times of the first frames. The
recording ends early when stdin is closed.
"""

import json
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import STREAM_SILENT
from pipeline.core.problems.session_codes import VIDEO_UNREADABLE
from pipeline.run.live.cameras.feed import StreamProcess, StreamProcessError
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.cameras.stream_program import StreamRequest
from pipeline.run.live.packets import CaptureAnswer, framed, read_message

_LOOK_S = 0.2
# Longest wait for the first picture, and for the end of a file once it is asked for.
_OPEN_S, _END_S = 20.0, 20.0
# Size that devices are asked for; there is no calibration yet.
_DEVICE_PX = (1280, 720)


class _Recorded:
    """Recording of a camera by a process of its own, and what came of it."""

    def __init__(self, source: CameraSource, path: Path, stop: threading.Event) -> None:
        self._source, self._stop = source, stop
        self._request = StreamRequest(source.kind, source.address, _DEVICE_PX, source.host, str(path))
        self.is_open = False
        self.answer: dict[str, Any] | None = None
        self.problem: Problem | None = None

    def run(self) -> None:
        """Record until the event; a camera that can't be recorded ends all others."""
        try:
            with StreamProcess(self._request) as process:
                self._watch(process)
        except StreamProcessError:
            self._fail(VIDEO_UNREADABLE, "The decoder crashed, or needs more memory than is allowed.", None)

    def _watch(self, process: StreamProcess) -> None:
        end_s, is_told = time.monotonic() + _OPEN_S, False
        for message in process.messages(_LOOK_S):
            match message:
                case {"kind": "opened"}:
                    self.is_open = True
                case {"kind": "recorded"} if is_told:
                    self.answer = message
                    return
                case {"kind": "ended", "code": code, "message": text, "hint": hint}:
                    self._fail(code, text, hint)
                    return
                case {"kind": "ended"}:
                    self._fail(STREAM_SILENT, "The camera has ended the stream.", "See that it is on.")
                    return
            if self._stop.is_set() and not is_told:
                process.tell(stop=True)
                is_told, end_s = True, time.monotonic() + _END_S
            if time.monotonic() > end_s and (is_told or not self.is_open):
                self._fail(STREAM_SILENT, "The camera sends no pictures.", "See that it is on.")
                return

    def _fail(self, code: Any, message: str, hint: str | None) -> None:
        self.problem = Problem(code, message, file=self._source.shown, camera=self._source.camera, hint=hint)


def _stop_at_end(incoming: BinaryIO, stop: threading.Event) -> None:
    read_message(incoming)
    stop.set()


def run(incoming: BinaryIO, outgoing: BinaryIO) -> int:
    """Record the cameras; return the exit code."""

    def send(kind: CaptureAnswer, content: Any) -> None:
        outgoing.write(framed(kind.value + json.dumps(content, separators=(",", ":")).encode()))
        outgoing.flush()

    if (content := read_message(incoming)) is None:
        return 0
    start, stop = json.loads(content), threading.Event()
    cameras = [
        _Recorded(CameraSource(**source), Path(start["folder"]) / f"{place}.mkv", stop)
        for place, source in enumerate(start["sources"])
    ]
    threading.Thread(target=_stop_at_end, args=(incoming, stop), daemon=True).start()
    with ExitStack() as held:
        pool = held.enter_context(ThreadPoolExecutor(len(cameras)))
        held.callback(stop.set)
        runs = [pool.submit(camera.run) for camera in cameras]
        # All problems are told at once, so that each camera is waited for until it is open or has failed.
        while not stop.is_set() and not all(camera.is_open or camera.problem for camera in cameras):
            stop.wait(_LOOK_S)
        if not any(camera.problem for camera in cameras):
            text = f"The cameras are open, and are recorded for {start['duration_s']:g} s."
            send(CaptureAnswer.TOLD, {"type": "notice", "message": text})
            end_s = time.monotonic() + start["duration_s"]
            while time.monotonic() < end_s and not any(run.done() for run in runs):
                if stop.wait(_LOOK_S):
                    break
    if problems := [camera.problem for camera in cameras if camera.problem]:
        send(CaptureAnswer.REFUSED, [asdict(problem) for problem in problems])
        return 2
    answers = [camera.answer or {} for camera in cameras]
    first_s = min(answer["first_s"] for answer in answers)
    frames = sum(answer["frames"] for answer in answers)
    offsets_s = [round(answer["first_s"] - first_s, 6) for answer in answers]
    send(CaptureAnswer.END, {"received": frames, "taken": frames, "offsets_s": offsets_s})
    return 0


if __name__ == "__main__":
    sys.exit(run(sys.stdin.buffer, sys.stdout.buffer))
