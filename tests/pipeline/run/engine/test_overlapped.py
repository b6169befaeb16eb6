"""Tasks in two threads: both at once, units in the thread of the caller, errors and ends as of one thread."""

import threading
from collections.abc import Callable
from contextlib import closing

import pytest

from pipeline.run.engine.local_tasks import overlapped
from pipeline.run.engine.stage import DETECT, Task

WAIT_S = 60.0


def tasks(number: int) -> list[Task]:
    return [Task(DETECT, index, f"cam{index}", range(10), 10, 3, f"key{index}") for index in range(number)]


def test_two_tasks_run_at_time() -> None:
    both = threading.Barrier(2)

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        both.wait(WAIT_S)  # fails if a task is alone
        on_unit()

    done = list(overlapped(tasks(6), run, lambda task: None))
    assert sorted(task.index for task in done) == list(range(6))


def test_no_third_task_runs_beside_them() -> None:
    running: set[int] = set()
    most: list[int] = []
    lock = threading.Lock()

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        with lock:
            running.add(task.index)
            most.append(len(running))
        on_unit()
        with lock:
            running.remove(task.index)

    assert len(list(overlapped(tasks(20), run, lambda task: None))) == 20
    assert max(most) <= 2


def test_units_are_counted_in_thread_of_caller() -> None:
    counted: list[tuple[int, int]] = []

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        for _ in range(task.num_units):
            on_unit()

    list(overlapped(tasks(3), run, lambda task: counted.append((task.index, threading.get_ident()))))
    assert sorted(counted) == [(index, threading.get_ident()) for index in range(3) for _ in range(3)]


def test_error_is_that_of_first_task_that_fails() -> None:
    """The second task fails before the first one does; its error would tell of another camera from run to run."""
    second_failed = threading.Event()

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        if task.index == 0:
            assert second_failed.wait(WAIT_S)
            on_unit()
            raise ValueError("first")
        second_failed.set()
        raise ValueError("second")

    with pytest.raises(ValueError, match="first"):
        list(overlapped(tasks(5), run, lambda task: None))


def test_error_ends_later_tasks_and_starts_no_more() -> None:
    started: list[int] = []

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        started.append(task.index)
        if task.index == 0:
            raise ValueError("first")
        while True:  # until the task is not wanted any more
            on_unit()

    with pytest.raises(ValueError, match="first"):
        list(overlapped(tasks(5), run, lambda task: None))
    assert sorted(started) == [0, 1]


def test_caller_that_stops_ends_tasks() -> None:
    ended: list[int] = []

    def run(task: Task, on_unit: Callable[[], None]) -> None:
        try:
            while task.index:
                on_unit()
        finally:
            ended.append(task.index)

    with closing(overlapped(tasks(5), run, lambda task: None)) as done:
        assert next(done).index == 0
    assert sorted(ended)[0] == 0
    assert not any("ThreadPool" in thread.name for thread in threading.enumerate())


def test_interruption_while_unit_is_counted_ends_tasks() -> None:
    def run(task: Task, on_unit: Callable[[], None]) -> None:
        while True:
            on_unit()

    def interrupt(task: Task) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(overlapped(tasks(2), run, interrupt))
    assert not any("ThreadPool" in thread.name for thread in threading.enumerate())
