"""``python -m pipeline.run.live.cameras.recording``: record cameras for a moment, for the service.

Messages go over stdin and stdout as ``pipeline.run.live.packets`` says. The start is an object with ``sources``, the
fields of a ``CameraSource`` each; ``duration_s``, counted from the time at which all cameras are open; and ``folder``,
which gets a video of each camera, ``0.mkv`` and so on. The end has ``offsets_s``, the times of the first frames. The
recording ends early when stdin is closed.
"""

import contextlib
import json
import math
import queue
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

from pipeline.core.errors import InputError, Problem
from pipeline.run.live.cameras.feed import CameraFeed, FeedEnded, FeedEvent, FeedOpened, FrameDecoded
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.packets import CaptureAnswer, framed, read_message

_LOOK_S = 0.2
# Size that devices are asked for; there is no calibration yet.
_DEVICE_PX = (1280, 720)
_Events = queue.SimpleQueue[FeedEvent | None]


def run(incoming: BinaryIO, outgoing: BinaryIO) -> int:
    """Record the cameras; return the exit code."""

    def send(kind: CaptureAnswer, content: Any) -> None:
        outgoing.write(framed(kind.value + json.dumps(content, separators=(",", ":")).encode()))
        outgoing.flush()

    def stop_at_end() -> None:
        read_message(incoming)
        events.put(None)

    if (content := read_message(incoming)) is None:
        return 0
    start, events = json.loads(content), _Events()
    threading.Thread(target=stop_at_end, daemon=True).start()
    folder, told = Path(start["folder"]), f"The cameras are open, and are recorded for {start['duration_s']:g} s."
    feeds = [
        CameraFeed(place, CameraSource(**source), _DEVICE_PX, 0, events, str(folder / f"{place}.mkv"))
        for place, source in enumerate(start["sources"])
    ]
    try:
        times_s = _record(
            feeds, events, start["duration_s"], lambda: send(CaptureAnswer.TOLD, {"type": "notice", "message": told})
        )
    except InputError as refused:
        send(CaptureAnswer.REFUSED, [asdict(problem) for problem in refused.problems])
        return 2
    finally:
        for feed in feeds:
            feed.close()
        for feed in feeds:
            feed.join()
    num_frames = sum(map(len, times_s))
    offsets_s = [round(camera_s[0] - min(times_s)[0], 6) for camera_s in times_s]
    send(CaptureAnswer.END, {"received": num_frames, "taken": num_frames, "offsets_s": offsets_s})
    return 0


def _record(
    feeds: Sequence[CameraFeed], events: _Events, duration_s: float, tell_open: Callable[[], None]
) -> list[list[float]]:
    """Record until each video is whole; return the times of its frames, by camera.

    An event ``None`` ends it early. Raises ``InputError`` with the problems of all cameras that can't be recorded.
    """
    opened, ended, problems = set[int](), set[int](), dict[int, Problem]()
    times_s: list[list[float]] = [[] for _ in feeds]
    end_s, is_stopped = math.inf, False
    while len(ended) < len(feeds):
        with contextlib.suppress(queue.Empty):
            match events.get(timeout=_LOOK_S):
                case None:
                    end_s = 0.0
                case FeedOpened(camera):
                    opened.add(camera)
                case FrameDecoded(camera, _, time_s):
                    times_s[camera].append(time_s)
                case FeedEnded(camera, problem):
                    ended.add(camera)
                    problems |= {} if problem is None else {camera: problem}
        # All problems are told at once, so that each camera is waited for until it is open or has failed.
        if len(opened | ended) < len(feeds):
            continue
        if problems:
            raise InputError([problems[camera] for camera in sorted(problems)])
        if math.isinf(end_s):
            tell_open()
            end_s = time.monotonic() + duration_s
        if time.monotonic() >= end_s and not is_stopped:
            is_stopped = True
            for feed in feeds:
                feed.stop()
    return times_s


if __name__ == "__main__":
    sys.exit(run(sys.stdin.buffer, sys.stdout.buffer))
