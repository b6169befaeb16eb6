"""Processes that detect are killed, and started again."""

import os
import signal
from concurrent.futures import wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

import pytest

from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.run.live.cameras.detector_pool import DetectorPool


def die_once(mark: Path) -> str:
    """Kill this process, but for the next time."""
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail() -> None:
    raise ValueError("wrong picture")


def test_work_of_killed_process_is_done_again(tmp_path: Path) -> None:
    told: list[str] = []
    with DetectorPool(partial(ProcessPool, 2), told.append) as pool:
        futures = [pool.submit(abs, -number) for number in range(3)]
        futures += [pool.submit(die_once, tmp_path / "mark")]
        futures += [pool.submit(abs, -number) for number in range(3, 6)]
        wait(futures, 60)
        assert [future.result(0) for future in futures] == [0, 1, 2, "alive", 3, 4, 5]
        assert len(told) == 1
        assert pool.submit(abs, -7).result(60) == 7
        with pytest.raises(ValueError, match="wrong picture"):
            pool.submit(fail).result(60)


@pytest.mark.slow
def test_processes_that_die_again_and_again_are_error() -> None:
    told: list[str] = []
    with DetectorPool(partial(ProcessPool, 1), told.append) as pool:
        with pytest.raises(BrokenProcessPool):
            pool.submit(die).result(120)
        assert len(told) == 5
        with pytest.raises(BrokenProcessPool):
            pool.submit(abs, 1).result(60)
