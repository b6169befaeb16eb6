"""Programs that are forked from a server, which has loaded their modules, and are confined. Standard library only.

A program that starts by itself loads its modules for seconds. The server loads them once, has one thread, opens no
file of a client's, and forks for each request. Its stdin is a socket to the process that started it: it ends when the
socket is closed, and its forks end with it.

A request is one message: a ``ForkRequest``, with a socket of the fork's own and the files that become its stdin, stdout
and stderr. Over the socket come the process id and, at the end, the exit code. The process id is not used again until
the other side shuts the socket down; then the fork is killed with all processes of its session.
"""

import contextlib
import gc
import json
import os
import resource
import select
import signal
import socket
import struct
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

from pipeline.core.runtime.parent_watch import die_with_parent
from pipeline.core.runtime.resources import lower_priority

NUMBER = struct.Struct("<i")
"""Process id or exit code on the socket of a fork."""

Program = Callable[[Sequence[str]], int]
"""Program that is forked: takes its arguments, and returns its exit code."""

_MAX_REQUEST_BYTES = 2**16
_NUM_FILES = 4
_MAX_DESCRIPTORS = 2**20


@dataclass(frozen=True, slots=True)
class ForkRequest:
    """Request for a fork.

    - ``program``: name of the program at the server.
    - ``arguments``: arguments of the program.
    - ``folder``: folder of its temporary files.
    - ``memory_bytes``, ``file_bytes``: largest memory of the process, and size of a file that it writes.
    - ``cpu_s``: longest computing time; ``None``: no limit.
    - ``nice``: niceness of the process.
    """

    program: str
    arguments: tuple[str, ...]
    folder: str
    memory_bytes: int
    file_bytes: int
    cpu_s: int | None
    nice: int


def send_request(server: socket.socket, request: ForkRequest, files: Sequence[int]) -> socket.socket:
    """Ask the server for a fork; return the fork's socket.

    ``files`` are stdin, stdout and stderr of the fork. Raises ``OSError`` if the server has ended.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            socket.send_fds(server, [json.dumps(asdict(request)).encode()], [theirs.fileno(), *files])
        except BaseException:
            ours.close()
            raise
    return ours


def serve(programs: Mapping[str, Program]) -> None:
    """Fork a program for each request until stdin is closed.

    Raises ``RuntimeError`` if the process has several threads: locks that they hold would stay locked in a fork.
    """
    if (num_threads := sum(1 for _ in Path("/proc/self/task").iterdir())) > 1:
        raise RuntimeError(f"a process with {num_threads} threads can't be forked")
    # Forks share the memory of what is loaded, as long as no collection of theirs writes to it.
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=os.dup(sys.stdin.fileno())) as requests:
        _Server(requests, programs).run()


@dataclass(slots=True)
class _Forked:
    """Forked process, which leads a session."""

    pid: int
    ended: int  # File that is readable when the process has ended
    owner: socket.socket
    is_abandoned: bool = False
    has_ended: bool = False


class _Server:
    def __init__(self, requests: socket.socket, programs: Mapping[str, Program]) -> None:
        self._requests, self._programs = requests, programs
        self._poll = select.poll()
        self._poll.register(requests, select.POLLIN)
        self._forks: dict[int, _Forked] = {}  # By both of their files

    def run(self) -> None:
        """Serve until the socket of the requests is closed."""
        while True:
            for file, _ in self._poll.poll():
                if file == self._requests.fileno():
                    if not self._accept():
                        return
                elif (fork := self._forks.get(file)) is not None:
                    self._look_after(fork, file)

    def _accept(self) -> bool:
        """Fork for the next request; return whether there was one."""
        message, files, _, _ = socket.recv_fds(self._requests, _MAX_REQUEST_BYTES, _NUM_FILES)
        if not message:
            return False
        owner = socket.socket(fileno=files[0])
        server = os.getpid()
        try:
            pid = os.fork()
        except OSError:
            traceback.print_exc()
            owner.close()
        else:
            if pid == 0:
                _become(self._programs, message, files, server)
            self._add(_Forked(pid, os.pidfd_open(pid), owner))
        for file in files[1:]:
            os.close(file)
        return True

    def _add(self, fork: _Forked) -> None:
        with contextlib.suppress(OSError):  # the owner is gone, which its socket tells
            fork.owner.sendall(NUMBER.pack(fork.pid))
        for file in (fork.ended, fork.owner.fileno()):
            self._forks[file] = fork
            self._poll.register(file, select.POLLIN)

    def _look_after(self, fork: _Forked, file: int) -> None:
        self._poll.unregister(file)
        if file == fork.ended:
            fork.has_ended = True
            status = os.waitid(os.P_PID, fork.pid, os.WEXITED | os.WNOWAIT)
            if status is not None:
                code = status.si_status if status.si_code == os.CLD_EXITED else -status.si_status
                with contextlib.suppress(OSError):
                    fork.owner.sendall(NUMBER.pack(code))
        else:
            fork.is_abandoned = True
            for kill in (os.kill, os.killpg):
                with contextlib.suppress(ProcessLookupError):
                    kill(fork.pid, signal.SIGKILL)
        if fork.has_ended and fork.is_abandoned:
            del self._forks[fork.ended], self._forks[fork.owner.fileno()]
            os.waitpid(fork.pid, 0)
            os.close(fork.ended)
            fork.owner.close()


def _become(programs: Mapping[str, Program], message: bytes, files: Sequence[int], server: int) -> NoReturn:
    """Run a program in the forked process, and end it without what the server does at its own end.

    A message that is no ``ForkRequest`` ends the process as an error of the program does.
    """
    exit_code = 1
    try:
        os.setsid()
        die_with_parent(server)
        for number, file in enumerate(files[1:]):
            os.dup2(file, number)
        os.closerange(len(files) - 1, _MAX_DESCRIPTORS)
        content = json.loads(message)
        request = ForkRequest(**content | {"arguments": tuple(content["arguments"])})
        _confine(request)
        exit_code = programs[request.program](request.arguments)
    except SystemExit as end:
        exit_code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(exit_code)


def _confine(request: ForkRequest) -> None:
    os.environ["TMPDIR"] = request.folder
    tempfile.tempdir = None
    for limit, number in (
        (resource.RLIMIT_DATA, request.memory_bytes),
        (resource.RLIMIT_FSIZE, request.file_bytes),
        (resource.RLIMIT_CPU, request.cpu_s),
    ):
        if number is not None:
            hard = resource.RLIM_INFINITY if limit == resource.RLIMIT_CPU else number
            resource.setrlimit(limit, (number, hard))
    lower_priority(request.nice)
