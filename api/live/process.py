"""Process that computes a live capture, with limits on its memory; a crash or a hang of it is that of one capture."""

import asyncio
import contextlib
import os
import resource
import signal
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import structlog

from api.live.problems import failed
from pipeline.live.pipes import LENGTH, CaptureAnswer, framed
from worker.process.priorities import lower_priority

_log = structlog.get_logger(__name__)

# As a check of files: below the answers of the service.
_NICE = 5
_MAX_LOG_BYTES = 2**20
_LOGGED_BYTES = 4000
_ENDED_S = 10.0


@dataclass(frozen=True, slots=True)
class CaptureProcess:
    """Running process of a live capture."""

    process: Process

    async def send(self, message: bytes) -> None:
        """Send a message as soon as the process takes it; raises ``SocketProblem`` if the process has ended."""
        if self.process.stdin is None:
            raise failed()
        try:
            self.process.stdin.write(framed(message))
            await self.process.stdin.drain()
        except (BrokenPipeError, ConnectionResetError):
            raise failed() from None

    async def answer(self) -> tuple[CaptureAnswer, bytes]:
        """Next answer of the process; raises ``SocketProblem`` if the process has ended without it."""
        if self.process.stdout is None:
            raise failed()
        try:
            length = LENGTH.unpack(await self.process.stdout.readexactly(LENGTH.size))[0]
            content = await self.process.stdout.readexactly(length)
            return CaptureAnswer(content[:1]), content[1:]
        except (asyncio.IncompleteReadError, ValueError):
            raise failed() from None


@contextlib.asynccontextmanager
async def capture_process(command: Sequence[str], folder: Path, memory_bytes: int) -> AsyncIterator[CaptureProcess]:
    """Run the process during the block; at its end it is killed, and why it had ended by itself is logged.

    Parameters
    ----------
    folder
        Folder for its log and temporary files, which the caller removes.
    """
    log_path = folder / "capture.log"
    with log_path.open("wb") as log:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=PIPE,
            stdout=PIPE,
            stderr=log,
            env=os.environ | {"TMPDIR": str(folder)},
            start_new_session=True,
        )
    try:
        with contextlib.suppress(ProcessLookupError):  # it may have ended
            resource.prlimit(process.pid, resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (_MAX_LOG_BYTES, _MAX_LOG_BYTES))
            lower_priority(_NICE, process.pid)
        yield CaptureProcess(process)
    finally:
        await _end(process, log_path)


async def _end(process: Process, log_path: Path) -> None:
    with contextlib.suppress(TimeoutError, ProcessLookupError):
        if process.stdin is not None:
            process.stdin.close()
        if process.returncode is None:
            # A child that was not waited for keeps its process id, so the group is its own.
            os.killpg(process.pid, signal.SIGKILL)
        async with asyncio.timeout(_ENDED_S):
            if process.stdout is not None:
                # Unread answers would keep the pipe open.
                await process.stdout.read()
            await process.wait()
    if process.returncode not in {0, 2, -signal.SIGKILL}:
        text = log_path.read_bytes()[-_LOGGED_BYTES:].decode(errors="replace")
        _log.error("live_process_ended", exit_code=process.returncode, log=text)
