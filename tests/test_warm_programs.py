"""Programs that are forked for tests end and answer as those that users start."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.confinement import ChildLimits
from tests.waiting import is_alive, wait_for
from tests.warm_programs import WarmPrograms

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks are told from others by Linux's files")

CHECK = "pipeline.export.character.check_character"


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmPrograms]:
    with WarmPrograms(tmp_path_factory.mktemp("programs")) as programs:
        yield programs


@pytest.fixture
def waiting(programs: WarmPrograms) -> "Iterator[subprocess.Popen[bytes]]":
    """Program that waits for its stdin."""
    limits = json.dumps(ChildLimits(cpu_s=None))
    command = programs.python_command("-m", "pipeline.video.probe", str(os.getpid()), limits)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield process


def fork_of_the_server() -> psutil.Process:
    """The only program that runs."""
    servers = [child for child in psutil.Process().children() if "tests.warm_programs" in child.cmdline()]
    wait_for(lambda: any(server.children() for server in servers))
    (fork,) = [fork for server in servers for fork in server.children()]
    return fork


@pytest.mark.parametrize("arguments", [[], ["no-such-file.glb"], ["--help"]])
def test_output_and_exit_code_are_those_of_program(
    programs: WarmPrograms, arguments: list[str], tmp_path: Path
) -> None:
    def ends(command: list[str]) -> tuple[int, bytes, bytes]:
        process = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
        return process.returncode, process.stdout, process.stderr.replace(b"check.py", b"")

    assert ends(programs.python_command("-m", CHECK, *arguments)) == ends(module_command(CHECK, *arguments))


def test_other_programs_are_not_forked(programs: WarmPrograms) -> None:
    assert programs.python_command("-m", "api") == module_command("api")


@pytest.mark.parametrize("number", [signal.SIGXCPU, signal.SIGKILL])
def test_signal_that_ends_fork_ends_client(waiting: "subprocess.Popen[bytes]", number: int) -> None:
    fork_of_the_server().send_signal(number)
    assert waiting.wait(60) == -number


@pytest.mark.parametrize("sent", [b"", b"\x00\x00\x00\x09{"])
def test_clients_killed_early_leave_server_whole(programs: WarmPrograms, sent: bytes) -> None:
    command = programs.python_command("-m", CHECK)
    for _ in range(3):
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(command[4])
            client.sendall(sent)
    assert subprocess.run(command, capture_output=True, check=False).returncode == 2


def test_fork_ends_with_its_client(waiting: "subprocess.Popen[bytes]") -> None:
    fork = fork_of_the_server()
    waiting.kill()
    wait_for(lambda: not is_alive(fork))
