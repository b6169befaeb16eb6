"""Stop of the service: at any moment no process has to be killed, and an idle service stops quickly."""

import os
import signal
import statistics
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from api.cli.served import READY
from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.e2e.serving import COMMAND, NUM_PROCESSES
from tests.waiting import wait_for

IDLE_S = 2.0


def start(data_dir: Path) -> subprocess.Popen[str]:
    command = tied_to_parent([*COMMAND, "--port", "0", "--data", str(data_dir)])
    environment = os.environ | {"MULTICAP_NICE": "0"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def stop(process: subprocess.Popen[str], number: signal.Signals) -> tuple[float, str]:
    """Stop a service; return the seconds until its end, and its output."""
    asked_s = time.monotonic()
    process.send_signal(number)
    process.wait(60)
    seconds = time.monotonic() - asked_s
    return seconds, process.communicate()[1]


@pytest.mark.parametrize(("number", "is_ready"), [(signal.SIGTERM, True), (signal.SIGINT, False)])
def test_service_is_stopped_without_killing(tmp_path: Path, number: signal.Signals, is_ready: bool) -> None:
    process = start(tmp_path)
    tree = [psutil.Process(process.pid)]
    if is_ready:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(READY)
    else:  # the worker's processes exist and load their libraries
        wait_for(lambda: len(psutil.Process(process.pid).children(recursive=True)) == NUM_PROCESSES - 1)
    tree += tree[0].children(recursive=True)
    _, said = stop(process, number)
    assert said.splitlines()[-1] == "Stopped."
    assert "killed" not in said
    assert process.returncode == 0
    assert not any(one.is_running() for one in tree)


@pytest.mark.benchmark
def test_idle_service_ends_at_once(tmp_path: Path) -> None:
    took_s = []
    for number in range(5):
        process = start(tmp_path / str(number))
        assert process.stdout is not None
        assert process.stdout.readline().startswith(READY)
        time.sleep(3.0)
        seconds, said = stop(process, (signal.SIGINT, signal.SIGTERM)[number % 2])
        assert "killed" not in said
        took_s.append(seconds)
    print(f"an idle service ends in {statistics.median(took_s):.2f} s, at most {max(took_s):.2f}")  # noqa: T201
    assert max(took_s) < IDLE_S
