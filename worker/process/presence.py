"""Presence of a worker process: its row in the list of workers, renewed by a thread."""

import os
import socket
import threading
import time
from collections.abc import Callable
from functools import partial

import structlog
from sqlalchemy.exc import SQLAlchemyError

from worker.jobs.repositories.workers import Workers
from worker.jobs.worker_status import WorkerStatus
from worker.process.scratch import is_running

log = structlog.get_logger()

_LOOK_S = 0.2
_TELL_S = 4.0
_STOP_S = 1.0


def process_name() -> str:
    """Name of this process among all workers: host and process id."""
    return f"{socket.gethostname()}:{os.getpid()}"


def forget_lost(workers: Workers) -> None:
    """Remove killed processes of this machine from the list, where they would stay for some seconds."""
    named = [(worker.id, *worker.id.rsplit(":", 1)) for worker in workers.all()]
    here = socket.gethostname()
    workers.remove([name for name, host, pid in named if host == here and not is_running(int(pid))])


class Presence:
    """Reports the status of this process to the job store: every few seconds, and as soon as it changes.

    If the database is away, the report is skipped and the work goes on.

    Parameters
    ----------
    workers
        List of workers in the job store.
    look
        Returns the present status; ``None`` when the process takes no more work. Called from the thread.
    """

    def __init__(self, workers: Workers, look: Callable[[], WorkerStatus | None]) -> None:
        self._workers, self._look = workers, look
        self._name = process_name()
        self._ended = threading.Event()
        self._is_told = True
        self._thread = threading.Thread(target=self._tell_forever, daemon=True)

    def start(self) -> None:
        """Begin to report."""
        self._thread.start()

    def stop(self) -> None:
        """Remove this process from the list."""
        self._ended.set()
        self._thread.join(_STOP_S)  # without a database the row expires by itself

    def _tell_forever(self) -> None:
        told: WorkerStatus | None = None
        told_s = 0.0
        while not self._ended.is_set():
            try:
                status = self._look()
            except OSError:  # such as of a folder in a network that is away
                log.exception("presence_not_known")
                self._ended.wait(_TELL_S)
                continue
            if status is None:
                break
            now_s = time.monotonic()
            if status != told or now_s - told_s >= _TELL_S:
                self._try(partial(self._workers.report, status))
                told, told_s = status, now_s
            self._ended.wait(_LOOK_S)
        self._try(partial(self._workers.remove, [self._name]))

    def _try(self, tell: Callable[[], None]) -> None:
        try:
            tell()
        except SQLAlchemyError as error:
            if self._is_told:  # once for as long as the database is away
                log.warning("presence_not_told", reason=type(error).__name__)
            self._is_told = False
        else:
            self._is_told = True
