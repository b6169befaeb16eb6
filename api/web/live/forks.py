"""Server from which the processes of live captures are forked."""

import contextlib
import os
import socket
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO

import structlog

from api.web.sessions.preflight import NICE
from api.web.settings import Settings
from pipeline.core.runtime.forks import ForkRequest, send_request
from pipeline.core.runtime.resources import lower_priority

_log = structlog.get_logger(__name__)

_LOGGED_BYTES = 4000
_ANSWERS_TO_START = 6
# Of the service's environment the forks get these names, and names that begin with the prefixes: no passwords, no keys.
_NAMES = frozenset(
    {"HOME", "LANG", "LD_LIBRARY_PATH", "MULTICAP_HOME", "MULTICAP_PROVIDER", "PATH", "TMPDIR", "TZ", "USER"}
)
_PREFIXES = ("LC_", "NUMBA_", "OMP_", "PYTHON", "XDG_")
# A process that forks must have no threads, and OpenBLAS would start some.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True, slots=True)
class _Running:
    process: subprocess.Popen[bytes]
    requests: socket.socket
    log: IO[bytes]


class ForkServer:
    """Server of ``pipeline.core.runtime.forks``. It is started for the first fork, and again if it has ended."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = command
        self._running: _Running | None = None
        self._lock = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Process id of the server; ``None`` if it was not started."""
        return None if self._running is None else self._running.process.pid

    def fork(self, request: ForkRequest, files: Sequence[int]) -> socket.socket:
        """Ask for a fork; return its socket, which tells its process id, as soon as it runs, and its exit code.

        ``files`` become stdin, stdout and stderr of the fork.
        """
        with self._lock:
            if self._running is not None and self._running.process.poll() is None:
                with contextlib.suppress(OSError):  # it has ended just now
                    return send_request(self._running.requests, request, files)
            self._end()
            self._running = _started(self._command)
            return send_request(self._running.requests, request, files)

    def close(self) -> None:
        """End the server and its forks."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        """Wait for the end of a server that was killed, or is to end now; log why it has ended by itself."""
        if (running := self._running) is None:
            return
        self._running = None
        exit_code = running.process.poll()
        running.requests.close()
        running.process.kill()
        running.process.wait()
        with running.log as log:
            if exit_code is not None:
                log.seek(max(0, log.seek(0, os.SEEK_END) - _LOGGED_BYTES))
                _log.error("live_server_ended", exit_code=exit_code, log=log.read().decode(errors="replace"))


def bare_environment() -> dict[str, str]:
    """Environment of processes of live captures, without passwords and keys."""
    return {name: text for name, text in os.environ.items() if name in _NAMES or name.startswith(_PREFIXES)}


def start_limit_s(settings: Settings) -> float:
    """Longest time until a fork runs and answers: the server imports everything first, and compiles what is not yet."""
    return _ANSWERS_TO_START * settings.live_answer_s


def _started(command: Sequence[str]) -> _Running:
    log = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the server has ended
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        process = subprocess.Popen(  # noqa: S603 - the command is the operator's
            command,
            stdin=theirs.fileno(),
            stdout=log,
            stderr=log,
            env=bare_environment() | _ONE_THREAD,
            start_new_session=True,
        )
    lower_priority(NICE, process.pid)
    return _Running(process, ours, log)
