"""Programs that check files, forked from a process that has loaded them.

Hundreds of tests open a file in a child process, ``python -m pipeline.video.probe`` for instance, which loads NumPy and
FFmpeg for a third of a second or more. In a process of tests ``WarmPrograms.python_command`` replaces
``python_command``: the command of such a program is a small client of a server, which loads it once and forks. The fork
gets the client's arguments, environment, folder and open files, and the client ends as the fork does. A fork
whose client is killed is killed too. Only the limits that a parent sets for its child do not reach the fork. On other
systems than Linux nothing is replaced.

``python -P -m tests.warm_programs SOCKET`` is the server; it ends when its stdin is closed.
"""

import contextlib
import gc
import importlib
import marshal
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

from pipeline.core.runtime import child_processes, parent_watch

PROGRAMS = (
    "pipeline.calibration.on_request",
    "pipeline.capture.keypoint_files.read_hdf5",
    "pipeline.capture.preflight",
    "pipeline.export.character.check_character",
    "pipeline.detection.own.check_network",
    "pipeline.run.live.cameras.stream_program",
    "pipeline.run.live.keeping",
    "pipeline.video.decode_process",
    "pipeline.video.playback.proxy",
    "pipeline.video.probe",
    "pipeline.video.sound",
)

PYTHON_COMMAND = child_processes.python_command
"""Function that ``WarmPrograms.python_command`` replaces."""

# It imports next to nothing: that is its purpose.
_CLIENT = """
import _socket, marshal, os, sys
server = _socket.socket(_socket.AF_UNIX, _socket.SOCK_STREAM)
server.connect(sys.argv[1])
files = [int(name) for name in os.listdir("/proc/self/fd") if int(name) != server.fileno()]
files = [file for file in files if os.path.exists(f"/proc/self/fd/{file}")]
content = marshal.dumps((sys.argv[2:], dict(os.environ), os.getcwd(), files))
rights = b"".join(file.to_bytes(4, sys.byteorder) for file in files)
server.sendmsg([len(content).to_bytes(4, "big")], [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, rights)])
server.sendall(content)
exit_code = int.from_bytes(server.recv(4), "big", signed=True)
if exit_code < 0:
    import signal
    signal.signal(-exit_code, signal.SIG_DFL) if -exit_code != signal.SIGKILL else None
    os.kill(os.getpid(), -exit_code)
os._exit(exit_code)
"""

# Files of a fork lie above those of the server while they are brought to their numbers.
_FIRST_MOVED = 512
_MAX_FILES = 64


class WarmPrograms:
    """Server of one process of tests, started with the first program; to be used in a ``with`` block."""

    def __init__(self, folder: Path) -> None:
        self._client, self._socket = folder / "client.py", folder / "socket"
        self._client.write_text(_CLIENT, encoding="utf-8")
        # A test that changes the environment may start the first program: modules would be loaded with its settings.
        changes = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[1])}
        self._environment = os.environ | changes
        self._server: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.communicate(timeout=60)

    def python_command(self, *arguments: str) -> list[str]:
        """Command that runs this interpreter, as ``child_processes.python_command`` returns it."""
        if sys.platform != "linux" or arguments[0] != "-m" or arguments[1] not in PROGRAMS:
            return PYTHON_COMMAND(*arguments)
        with self._lock:
            if self._server is None:
                self._server = self._started()
        return client_command(self._client, self._socket, *arguments[1:])

    def command(self, module: str) -> tuple[str, ...]:
        """Command of a program, for settings of a service."""
        return tuple(self.python_command("-m", module))

    def _started(self) -> "subprocess.Popen[bytes]":
        command = PYTHON_COMMAND("-m", "tests.warm_programs", str(self._socket))
        server = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=self._environment, start_new_session=True
        )
        assert server.stdout is not None
        assert server.stdout.readline() == b"ready\n"
        return server


def client_command(client: Path, server: Path, *arguments: str) -> list[str]:
    """Command of a program with its arguments; ``server`` is the path of the server's socket."""
    return [sys.executable, "-I", "-S", str(client), str(server), *arguments]


def _serve(path: Path) -> None:
    """Fork for each client until stdin is closed."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen(64)
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    poll = select.poll()
    poll.register(0, select.POLLIN)
    poll.register(listener, select.POLLIN)
    clients: dict[int, tuple[socket.socket, int]] = {}  # Client and fork, by the number of the client's socket
    forks: dict[int, int] = {}  # Number of the client's socket, by the file of the fork
    while True:
        for file, _ in poll.poll():
            if file == 0:
                return
            if file == listener.fileno():
                client, _ = listener.accept()
                if (request := _request(client)) is None:
                    client.close()
                    continue
                fork = _forked(path, *request)
                clients[client.fileno()] = (client, fork)
                forks[ended := os.pidfd_open(fork)] = client.fileno()
                poll.register(client, select.POLLIN)
                poll.register(ended, select.POLLIN)
            elif file in forks:
                client, fork = clients[forks[file]]
                exit_code = os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1])
                with contextlib.suppress(OSError):
                    client.sendall(exit_code.to_bytes(4, "big", signed=True))
                poll.unregister(file)
                os.close(file)
                with contextlib.suppress(KeyError):
                    poll.unregister(client)
                del clients[forks.pop(file)]
                client.close()
            elif file in clients:
                poll.unregister(file)
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(clients[file][1], signal.SIGKILL)


def _request(client: socket.socket) -> tuple[list[int], tuple[Any, ...]] | None:
    """Files of a client, and its words and surroundings; ``None`` if it was killed before it had sent them."""
    files: list[int] = []
    try:
        head, files, _, _ = socket.recv_fds(client, 4, _MAX_FILES)
        content = client.recv(num_bytes := int.from_bytes(head, "big"), socket.MSG_WAITALL)
    except ConnectionError:
        content, num_bytes = b"", 0
    if 0 < num_bytes == len(content):
        return files, marshal.loads(content)  # noqa: S302 - from the client above
    for file in files:
        os.close(file)
    return None


def _forked(path: Path, files: list[int], request: tuple[Any, ...]) -> int:
    """Fork for a client; return the process, which is the first of a group of its own."""
    words, *surroundings = request
    if words[0] not in sys.modules:
        importlib.import_module(words[0])
        gc.freeze()
    process = os.fork()
    if process == 0:
        _become(path, files, words, *surroundings)
    with contextlib.suppress(OSError):  # it has ended
        os.setpgid(process, process)
    for file in files:
        os.close(file)
    return process


def _become(
    path: Path, files: list[int], words: list[str], environment: dict[str, str], folder: str, numbers: list[int]
) -> NoReturn:
    """Run a client's program in the forked process, and end it."""
    exit_code = 1
    try:
        os.setpgid(0, 0)
        moved = [os.dup2(file, _FIRST_MOVED + k) for k, file in enumerate(files)]
        os.closerange(3, _FIRST_MOVED)
        for file, number in zip(moved, numbers, strict=True):
            os.dup2(file, number)
        os.closerange(_FIRST_MOVED, _FIRST_MOVED + _MAX_FILES)
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        tempfile.tempdir = None
        module, *sys.argv[1:] = words
        # Its parent is the server, which kills it when the client ends.
        ties = parent_watch.die_with_parent
        parent_watch.die_with_parent = lambda parent: ties(parent) if parent == os.getppid() else None
        client = Path(path).with_name("client.py")
        child_processes.python_command = lambda *arguments: (
            client_command(client, path, *arguments[1:])
            if arguments[0] == "-m" and arguments[1] in PROGRAMS
            else PYTHON_COMMAND(*arguments)
        )
        del sys.modules[module]
        exit_code = 0
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        exit_code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        exit_code = 1
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
        with contextlib.suppress(OSError):
            sys.stderr.flush()
        os._exit(exit_code)


if __name__ == "__main__":
    _serve(Path(sys.argv[1]))
