"""Process that computes a live capture, with limits on its memory; its crash or hang ends one capture."""

import asyncio
import contextlib
import os
import signal
import socket
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import structlog

from api.web.http.websockets import SocketProblem
from api.web.live.forks import ForkServer, bare_environment
from api.web.live.problems import failed
from pipeline.core.runtime.forks import NUMBER, ForkRequest
from pipeline.core.runtime.resources import lower_priority
from pipeline.run.live.packets import LENGTH, CaptureAnswer, framed

_log = structlog.get_logger(__name__)

# As a check of files: below the answers of the service.
_NICE = 5
_NICE_OF_FLOODS = 19
_MAX_LOG_BYTES = 2**20
_LOGGED_BYTES = 4000
_ENDED_S = 10.0


@dataclass(frozen=True, slots=True)
class CaptureProcess:
    """Running process of a live capture."""

    pid: int
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    async def send(self, message: bytes) -> None:
        """Send a message as soon as the process takes it; raises ``SocketProblem`` if the process has ended."""
        try:
            self.writer.write(framed(message))
            await self.writer.drain()
        except ConnectionError:
            raise failed() from None

    async def answer(self) -> tuple[CaptureAnswer, bytes]:
        """Next answer of the process; raises ``SocketProblem`` if the process has ended without it."""
        try:
            length = LENGTH.unpack(await self.reader.readexactly(LENGTH.size))[0]
            content = await self.reader.readexactly(length)
            return CaptureAnswer(content[:1]), content[1:]
        except (asyncio.IncompleteReadError, ConnectionError, ValueError):
            raise failed() from None

    def stand_behind(self) -> None:
        """Let other captures go first, until the end of this one."""
        with contextlib.suppress(OSError):  # it may have ended
            lower_priority(_NICE_OF_FLOODS, self.pid)


@contextlib.asynccontextmanager
async def capture_process(server: ForkServer, folder: Path, memory_bytes: int) -> AsyncIterator[CaptureProcess]:
    """Run the process during the block; at its end it is killed, and why it had ended by itself is logged.

    ``folder`` is for its log and temporary files; the caller removes it.
    """
    log_path = folder / "capture.log"
    request = ForkRequest("capture", (), str(folder), memory_bytes, _MAX_LOG_BYTES, None, _NICE)
    ours, theirs = socket.socketpair()
    with theirs, log_path.open("wb") as log:
        owner = server.fork(request, (theirs.fileno(), theirs.fileno(), log.fileno()))
    reader, writer = await asyncio.open_unix_connection(sock=ours)
    numbers, ending = await asyncio.open_unix_connection(sock=owner)
    try:
        pid = await _number(numbers)
        try:
            yield CaptureProcess(pid, reader, writer)
        finally:
            await _end(numbers, ending, log_path)
    finally:
        for socket_writer in (writer, ending):
            socket_writer.transport.abort()


async def _number(numbers: asyncio.StreamReader) -> int:
    """Next number from the server; raises ``SocketProblem`` if the server has ended."""
    try:
        number: int = NUMBER.unpack(await numbers.readexactly(NUMBER.size))[0]
    except (asyncio.IncompleteReadError, ConnectionError):
        raise failed() from None
    return number


async def _end(numbers: asyncio.StreamReader, ending: asyncio.StreamWriter, log_path: Path) -> None:
    """Kill the process, unless it has ended, and wait for its end."""
    exit_code = None
    with contextlib.suppress(TimeoutError, OSError, SocketProblem):
        ending.write_eof()
        async with asyncio.timeout(_ENDED_S):
            exit_code = await _number(numbers)
    _log_end(exit_code, log_path)


@contextlib.asynccontextmanager
async def camera_process(command: Sequence[str], folder: Path, sockets: Sequence[int]) -> AsyncIterator[CaptureProcess]:
    """Run a program that opens cameras, and gets some sockets, like ``capture_process``; its children end with it."""
    log_path = folder / "capture.log"
    with log_path.open("wb") as log:
        child = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=log,
            env=bare_environment() | {"TMPDIR": str(folder)},
            pass_fds=sockets,
            start_new_session=True,
        )
    try:
        yield CaptureProcess(
            child.pid, cast(asyncio.StreamReader, child.stdout), cast(asyncio.StreamWriter, child.stdin)
        )
    finally:
        if child.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
        _log_end(await child.wait(), log_path)


def _log_end(exit_code: int | None, log_path: Path) -> None:
    if exit_code not in {0, 2, -signal.SIGKILL}:
        text = log_path.read_bytes()[-_LOGGED_BYTES:].decode(errors="replace")
        _log.error("live_process_ended", exit_code=exit_code, log=text)
