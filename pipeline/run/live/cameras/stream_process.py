"""Process of a camera's stream, ``stream_program``, and the pictures that it shares."""

import json
import os
import select
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Iterator
from typing import IO, Any, cast

from pipeline.core.runtime.child_processes import module_command, uninterrupted
from pipeline.run.live.cameras.stream_program import StreamRequest
from pipeline.video.children import READY, child_environment

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
        # Until nobody refers to it: a path must not lead to a later file.
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
