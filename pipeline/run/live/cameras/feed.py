"""Feed of a camera: its stream in a process, ``stream_program``, which is started again whenever it ends.

The process shares the pictures with this one.
"""

import json
import os
import queue
import select
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any, cast

from pipeline.core.errors import Problem
from pipeline.core.problems.code_group import Code
from pipeline.core.problems.finding_codes import STREAM_SILENT
from pipeline.core.problems.session_codes import VIDEO_CHANGES_SIZE, VIDEO_UNREADABLE
from pipeline.core.runtime.child_processes import module_command, uninterrupted
from pipeline.core.runtime.confinement import READY, child_environment
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.cameras.stream_program import StreamRequest

_MAX_LINE_BYTES = 2**16


class StreamProcessError(Exception):
    """The process ended by itself: its stream has made FFmpeg crash, or used too much memory."""


class StreamProcess:
    """Running process of a stream, to be used in a ``with`` block; at its end it is killed."""

    def __init__(self, request: StreamRequest) -> None:
        with uninterrupted():
            self._child = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                module_command("pipeline.run.live.cameras.stream_program"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=child_environment(),
                pass_fds=() if request.pictures is None else (request.pictures,),
                bufsize=0,
            )
        self._received = b""
        self.tell(**request._asdict())

    def __enter__(self) -> "StreamProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self._child.kill()
        with self._child:  # closes the pipes, and waits
            pass

    def tell(self, **values: object) -> None:
        """Send a message; a process that has ended does not get it."""
        try:
            cast(IO[bytes], self._child.stdin).write(json.dumps(values).encode() + b"\n")
        except (BrokenPipeError, ValueError):
            return

    def messages(self, timeout_s: float) -> Iterator[dict[str, Any] | None]:
        """Messages of the process; ``None`` when none has come within the time, which the caller may end.

        Raises ``StreamProcessError`` if the process ends.
        """
        for line in self._lines(timeout_s):
            if line is None:
                yield None
            elif line + b"\n" != READY:
                yield json.loads(line)

    def _lines(self, timeout_s: float) -> Iterator[bytes | None]:
        pipe = cast(IO[bytes], self._child.stdout).fileno()
        poll = select.poll()
        poll.register(pipe, select.POLLIN)
        while True:
            *lines, self._received = self._received.split(b"\n")
            yield from lines
            if not poll.poll(1000 * timeout_s):
                yield None
                continue
            content = os.read(pipe, _MAX_LINE_BYTES)
            if not content or len(self._received) > _MAX_LINE_BYTES:
                raise StreamProcessError
            self._received += content


class SharedPictures:
    """File in memory for some pictures, which the process of a stream writes and those that detect read."""

    def __init__(self, num_slots: int, height: int, width: int) -> None:
        self.shape = (num_slots, height, width, 3)
        self._file = _file_in_memory()
        self._file.truncate(num_slots * height * width * 3)
        # Closed with the last reference: a path must not lead to a later file.
        weakref.finalize(self, self._file.close)

    @property
    def path(self) -> str:
        """Path by which processes of the same user open the file."""
        if sys.platform == "linux":
            return f"/proc/{os.getpid()}/fd/{self._file.fileno()}"
        return str(self._file.name)


def _file_in_memory() -> IO[bytes]:
    """File that is removed when it is closed, in memory where the system supports it."""
    if sys.platform == "linux":
        return os.fdopen(os.memfd_create("multicap-pictures"), "w+b")
    return cast(IO[bytes], tempfile.NamedTemporaryFile(prefix="multicap-"))


# Longest wait for the first picture, and for the next one; the stream's own time-outs are shorter.
_OPEN_S, _SILENT_S = 15.0, 6.0
# A pause before another try is twice the last one.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 30.0
_LOOK_S = 0.5


@dataclass(frozen=True, slots=True)
class PictureFormat:
    """Form of a stream's pictures."""

    stored_size_px: tuple[int, int]  # Width and height, before pixels become square and before rotation
    square_width: int  # Width of the pictures with square pixels
    rotation_deg: int  # Counterclockwise turn for display, after ``is_mirrored``
    is_mirrored: bool = False  # True if left and right of the stored picture are exchanged for display

    @property
    def shown_size_px(self) -> tuple[int, int]:
        """Width and height as shown."""
        size_px = self.square_width, self.stored_size_px[1]
        return size_px if self.rotation_deg % 180 == 0 else size_px[::-1]


@dataclass(frozen=True, slots=True)
class FeedOpened:
    """A stream has begun: at first, or again."""

    camera: int
    format: PictureFormat
    rate_hz: float  # Rate that the stream states; 0: it states none


@dataclass(frozen=True, slots=True)
class FrameDecoded:
    """A frame was decoded, and is the newest one."""

    camera: int
    number: int  # Number of frames so far, of this opening of the stream
    time_s: float  # Time at which it was taken, of ``time.monotonic``


@dataclass(frozen=True, slots=True)
class PictureReady:
    """A picture that was asked for is in the shared file."""

    camera: int
    slot: int
    time_s: float
    pictures: SharedPictures


@dataclass(frozen=True, slots=True)
class FeedEnded:
    """A stream has ended."""

    camera: int
    problem: Problem | None  # ``None`` at the end of a file or of a recording
    is_over: bool  # True if it is not opened again: a file or a recording


FeedEvent = FeedOpened | FrameDecoded | PictureReady | FeedEnded


class CameraFeed:
    """Feed of a camera; a thread reads what the process of its stream tells.

    ``camera``: position of the camera. ``size_px``: size of its pictures by the calibration. ``num_slots``: number of
    pictures that are held at a time. ``events``: queue that gets a ``FeedEvent`` for everything that happens.
    ``record``: new file that gets all frames up to ``stop``, in place of pictures; such a stream is not opened again.
    """

    def __init__(
        self,
        camera: int,
        source: CameraSource,
        size_px: tuple[int, int],
        num_slots: int,
        events: "queue.SimpleQueue[FeedEvent | None]",
        record: str | None = None,
    ) -> None:
        self._camera, self._source, self._num_slots, self._events = camera, source, num_slots, events
        self._request = StreamRequest(source.kind, source.address, size_px, source.host, record, source.pictures)
        self._may_end = source.kind == "file"
        self._format: PictureFormat | None = None
        self._process: StreamProcess | None = None
        self._pictures: SharedPictures | None = None
        self._is_waiting = source.kind == "file"  # until it is played
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def start(self, start_s: float) -> None:
        """Play a file from a time on; other streams have begun."""
        self._is_waiting = False
        if self._process is not None:
            self._process.tell(start_s=start_s)

    def ask(self, slot: int) -> None:
        """Ask for the newest picture."""
        if self._process is not None:
            self._process.tell(slot=slot)

    def stop(self) -> None:
        """End a recording; its stream has begun."""
        self._may_end = True
        if self._process is not None:
            self._process.tell(stop=True)

    def close(self) -> None:
        """End the process soon; ``join`` waits for its end."""
        self._is_closed.set()

    def join(self) -> None:
        """Wait for the end of the process."""
        self._thread.join()

    def _run(self) -> None:
        pause_s, is_once = _FIRST_PAUSE_S, self._source.kind == "file" or self._request.record is not None
        while not self._is_closed.is_set():
            started_s = time.monotonic()
            problem = self._watch()
            if self._is_closed.is_set():
                return
            self._events.put(FeedEnded(self._camera, problem, is_once))
            if is_once:
                return
            if time.monotonic() - started_s > _LONGEST_PAUSE_S:
                pause_s = _FIRST_PAUSE_S
            self._is_closed.wait(pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _watch(self) -> Problem:
        """Start the process, and pass on what it tells; return why the stream ended."""
        try:
            with StreamProcess(self._request) as self._process:
                return self._pass_on(self._process)
        except StreamProcessError:
            message = "The decoder crashed, or needs more memory than is allowed."
            return self._problem(VIDEO_UNREADABLE, message, "See what the camera sends.")
        except OSError as error:
            message = f"The decoder can't be started, or has no memory for pictures: {error.strerror}."
            return self._problem(VIDEO_UNREADABLE, message, "See how many processes and how much memory are left.")
        finally:
            self._process = self._pictures = None

    def _pass_on(self, process: StreamProcess) -> Problem:
        silent_s, is_at_end = time.monotonic() + _OPEN_S, False
        for message in process.messages(_LOOK_S):
            if message is not None or (self._format and self._is_waiting):
                silent_s = time.monotonic() + _SILENT_S
            if self._is_closed.is_set() or (time.monotonic() > silent_s and not is_at_end):
                break
            if message is None:
                continue
            match message["kind"]:
                case "opened":
                    if (problem := self._open(process, message)) is not None:
                        return problem
                case "decoded":
                    self._events.put(FrameDecoded(self._camera, message["number"], message["time_s"]))
                case "picture" if self._pictures is not None:
                    self._events.put(PictureReady(self._camera, message["slot"], message["time_s"], self._pictures))
                case "ended" if "code" in message:
                    return self._problem(message["code"], message["message"], message["hint"])
                case "ended" if self._may_end:
                    # The last pictures of a file may still be asked for.
                    self._events.put(FeedEnded(self._camera, None, is_over=True))
                    is_at_end = True
                case "ended":
                    return self._problem(STREAM_SILENT, "The camera has ended the stream.", "See that it is on.")
        return self._problem(STREAM_SILENT, "The camera sends no pictures.", "See that it is on.")

    def _open(self, process: StreamProcess, message: dict[str, Any]) -> Problem | None:
        stored_px, square_width = tuple(message["stored_size_px"]), message["square_width"]
        form = PictureFormat(stored_px, square_width, message["rotation_deg"], message["is_mirrored"])
        if self._format not in {None, form}:
            return self._problem(
                VIDEO_CHANGES_SIZE, "The size of the pictures has changed.", "Start the capture again."
            )
        self._format = form
        if self._request.record is None:
            self._pictures = SharedPictures(self._num_slots, stored_px[1], square_width)
            process.tell(path=self._pictures.path)
        self._events.put(FeedOpened(self._camera, form, message["rate_hz"]))
        return None

    def _problem(self, code: Code, message: str, hint: str | None) -> Problem:
        return Problem(code, message, file=self._source.shown, camera=self._source.camera, hint=hint)
