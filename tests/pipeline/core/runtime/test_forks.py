"""Programs that are forked from a server: what they get, their limits, and their end."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest

from pipeline.core.runtime.forks import NUMBER, ForkRequest, send_request
from tests.waiting import wait_for

SERVER = """
import atexit, json, os, resource, subprocess, sys, tempfile, time
from pipeline.core.runtime.forks import serve

LOADED = object()

@atexit.register
def end():
    with open(f"{sys.argv[0]}.ends", "a") as ends:
        print(os.getpid(), file=ends)

def show(arguments):
    names = ("RLIMIT_DATA", "RLIMIT_FSIZE", "RLIMIT_CPU")
    limits = {name: resource.getrlimit(getattr(resource, name)) for name in names}
    facts = {"arguments": arguments, "stdin": sys.stdin.read(), "folder": tempfile.gettempdir(), "limits": limits,
             "nice": os.getpriority(os.PRIO_PROCESS, 0), "leads": os.getsid(0) == os.getpid(), "parent": os.getppid(),
             "files": [os.readlink(path) for number in range(100) if os.path.exists(path := f"/proc/self/fd/{number}")]}
    print(json.dumps(facts))
    return 7

def fail(arguments):
    raise ValueError("wrong")

def take(arguments):
    bytearray(2**28)
    return 0

def wait(arguments):
    child = subprocess.Popen(["sleep", "600"])
    print(child.pid, flush=True)
    time.sleep(600)

serve({"show": show, "fail": fail, "take": take, "wait": wait})
"""


class ServedForks:
    """Running server."""

    def __init__(self, path: Path) -> None:
        self.requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self.process = subprocess.Popen([sys.executable, "-P", str(path)], stdin=theirs.fileno())

    def close(self) -> None:
        self.requests.close()
        self.process.wait(60)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[ServedForks]:
    path = tmp_path / "server.py"
    path.write_text(SERVER, encoding="utf-8")
    served = ServedForks(path)
    yield served
    served.close()


def number(owner: socket.socket) -> int:
    owner.settimeout(60)
    return int(NUMBER.unpack(owner.recv(NUMBER.size))[0])


@pytest.fixture
def request_of(tmp_path: Path) -> ForkRequest:
    return ForkRequest("show", ("a", "b"), str(tmp_path), 2**29, 2**20, 30, 11)


def forked(server: ServedForks, request: ForkRequest, folder: Path) -> socket.socket:
    """Socket of a fork that reads ``input`` and writes to the files ``output`` and ``log``."""
    (folder / "input").write_text("all of it", encoding="utf-8")
    with (
        (folder / "input").open("rb") as stdin,
        (folder / "output").open("wb") as output,
        (folder / "log").open("wb") as log,
    ):
        return send_request(server.requests, request, (stdin.fileno(), output.fileno(), log.fileno()))


def test_fork_gets_its_files_and_limits_and_nothing_else(
    server: ServedForks, request_of: ForkRequest, tmp_path: Path
) -> None:
    with forked(server, request_of, tmp_path) as owner:
        pid = number(owner)
        assert number(owner) == 7
    facts: dict[str, Any] = json.loads((tmp_path / "output").read_text())
    assert (facts["arguments"], facts["stdin"], facts["folder"]) == (["a", "b"], "all of it", str(tmp_path))
    assert facts["limits"]["RLIMIT_DATA"] == [2**29, 2**29]
    assert facts["limits"]["RLIMIT_FSIZE"] == [2**20, 2**20]
    assert facts["limits"]["RLIMIT_CPU"][0] == 30
    assert (facts["nice"], facts["leads"], facts["parent"]) == (11, True, server.process.pid)
    # Neither a socket of the server's is there nor one of other forks.
    assert facts["files"] == [str(tmp_path / name) for name in ("input", "output", "log")]
    assert pid != server.process.pid


def test_failure_is_that_of_fork(server: ServedForks, request_of: ForkRequest, tmp_path: Path) -> None:
    for changes, exit_code, log in (
        ({"program": "fail"}, 1, "ValueError: wrong"),
        ({"program": "unknown"}, 1, "KeyError"),
        ({"program": "take", "memory_bytes": 2**27}, 1, "MemoryError"),
        ({"program": "show"}, 7, ""),
    ):
        with forked(server, replace(request_of, **changes), tmp_path) as owner:
            number(owner)
            assert number(owner) == exit_code
        assert log in (tmp_path / "log").read_text()


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (b"{", "JSONDecodeError"),
        (b"[]", "TypeError"),
        (b"{}", "KeyError"),
        (b'{"arguments": [], "unknown": 1}', "TypeError"),
        (b"\xff", "UnicodeDecodeError"),
    ],
)
def test_malformed_request_ends_its_fork_alone(
    server: ServedForks, request_of: ForkRequest, tmp_path: Path, message: bytes, error: str
) -> None:
    log = tmp_path / "malformed.log"
    owner, theirs = socket.socketpair()
    with owner:
        with theirs, log.open("wb") as file:
            socket.send_fds(server.requests, [message], [theirs.fileno(), *[file.fileno()] * 3])
        number(owner)
        assert number(owner) == 1
    assert error in log.read_text()
    # The server serves, and is the only one: the fork did nothing that a server does at its end.
    with forked(server, request_of, tmp_path) as other:
        number(other)
        assert number(other) == 7
    wait_for(lambda: psutil.Process(server.process.pid).children() == [])
    server.close()
    assert (tmp_path / "server.py.ends").read_text().split() == [str(server.process.pid)]


def waiting(server: ServedForks, request: ForkRequest, folder: Path) -> tuple[socket.socket, list[psutil.Process]]:
    """Fork that has started a process, and both processes."""
    owner = forked(server, replace(request, program="wait"), folder)
    pid = number(owner)
    wait_for(lambda: (folder / "output").read_text().endswith("\n"))
    return owner, [psutil.Process(pid), psutil.Process(int((folder / "output").read_text()))]


def have_ended(processes: list[psutil.Process]) -> bool:
    return not any(process.is_running() and process.status() != psutil.STATUS_ZOMBIE for process in processes)


def test_fork_is_killed_with_its_children_when_its_owner_goes(
    server: ServedForks, request_of: ForkRequest, tmp_path: Path
) -> None:
    owner, processes = waiting(server, request_of, tmp_path)
    owner.shutdown(socket.SHUT_WR)
    assert number(owner) == -signal.SIGKILL
    wait_for(lambda: have_ended(processes))
    owner.close()
    with forked(server, request_of, tmp_path) as other:
        pid = number(other)
        assert number(other) == 7
        # Nobody else gets its number while the owner may use it.
        assert psutil.pid_exists(pid)
    wait_for(lambda: not psutil.pid_exists(pid))


def test_forks_end_with_killed_server(server: ServedForks, request_of: ForkRequest, tmp_path: Path) -> None:
    owner, processes = waiting(server, request_of, tmp_path)
    server.process.kill()
    wait_for(lambda: have_ended(processes[:1]))
    assert owner.recv(NUMBER.size) == b""
    processes[1].kill()
    owner.close()


def test_server_ends_when_nobody_can_ask(server: ServedForks, request_of: ForkRequest, tmp_path: Path) -> None:
    owner, processes = waiting(server, request_of, tmp_path)
    server.requests.close()
    assert server.process.wait(60) == 0
    wait_for(lambda: have_ended(processes[:1]))
    processes[1].kill()
    owner.close()


def test_process_with_threads_does_not_serve(tmp_path: Path) -> None:
    path = tmp_path / "server.py"
    thread = "import threading, time\nthreading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
    path.write_text(thread + SERVER, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-P", str(path)], check=False, stdin=subprocess.DEVNULL, capture_output=True, timeout=120
    )
    assert ended.returncode == 1
    assert b"2 threads" in ended.stderr
