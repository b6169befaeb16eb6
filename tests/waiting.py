"""Waiting for what other processes do."""

import time
from collections.abc import Callable

import psutil

SHORTEST_PAUSE_S, LONGEST_PAUSE_S = 0.05, 0.25
# Share of the time that has passed: services spend processor time on each question, which the tests beside it need.
PAUSE = 0.05


def wait_for(condition: Callable[[], bool], timeout_s: float = 180.0) -> None:
    """Wait until a condition holds; fail after the timeout. It is looked at less often the longer this takes."""
    started_s = time.monotonic()
    while not condition():
        waited_s = time.monotonic() - started_s
        assert waited_s < timeout_s, "nothing happened in time"
        time.sleep(min(max(SHORTEST_PAUSE_S, PAUSE * waited_s), LONGEST_PAUSE_S))


def is_alive(process: psutil.Process) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
