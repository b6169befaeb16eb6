"""Checks of parts of the service that may never respond, each with a time limit."""

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, TimeoutError
from typing import Any, TypeVar

_Result = TypeVar("_Result")


class LimitedChecks:
    """Runs checks side by side, each in a thread of its own.

    A check that hangs is not begun again before it has ended, so that a part that does not respond costs one thread. A
    check fails after ``limit_s``.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._lock = threading.Lock()
        self._running: dict[str, Future[Any]] = {}

    def run(self, checks: Mapping[str, Callable[[], _Result]]) -> dict[str, _Result | None]:
        """Results of checks by name; ``None`` for a check that has not ended in time."""
        deadline_s = time.monotonic() + self._limit_s
        with self._lock:
            futures = {name: self._begun(name, check) for name, check in checks.items()}
        return {name: _result(future, deadline_s - time.monotonic()) for name, future in futures.items()}

    def _begun(self, name: str, check: Callable[[], _Result]) -> Future[_Result]:
        running = self._running.get(name)
        if running is not None and not running.done():
            return running
        future = self._running[name] = Future[_Result]()
        # A daemon: it must not keep the process from ending.
        threading.Thread(target=_run, args=[check, future], name=f"check-{name}", daemon=True).start()
        return future


def _run(check: Callable[[], _Result], future: Future[_Result]) -> None:
    try:
        future.set_result(check())
    except BaseException as error:
        future.set_exception(error)


def _result(future: Future[_Result], timeout_s: float) -> _Result | None:
    try:
        return future.result(max(0.0, timeout_s))
    except TimeoutError:
        if future.done():  # the check itself raised it
            raise
        return None
