"""Presence of a worker process: its row in the list of workers, renewed from a thread."""

import os
import socket
import threading
import time
from collections.abc import Callable
from functools import partial

import structlog
from sqlalchemy.exc import SQLAlchemyError

from worker.run.process.scratch import is_running
from worker.store.repositories.work.workers import Workers
from worker.store.worker_status import WorkerState, WorkerStatus

log = structlog.get_logger()

# Installed packages of a ready process seldom change, and looking for them takes milliseconds.
_LOOK_S, _LOOK_READY_S = 0.2, 1.0
_REPORT_S = 4.0
_STOP_S = 1.0


def process_name() -> str:
    """Name of this process among all workers: host and process id."""
    return f"{socket.gethostname()}:{os.getpid()}"


def remove_killed(workers: Workers) -> None:
    """Remove killed processes of this machine from the list of workers, before their rows expire."""
    named = [(worker.id, *worker.id.rsplit(":", 1)) for worker in workers.all()]
    here = socket.gethostname()
    workers.remove([name for name, host, pid in named if host == here and not is_running(int(pid))])


class Presence:
    """Reports the status of this process to the job store: every four seconds, and as soon as it changes.

    The work goes on if the database does not respond; the report is repeated. ``workers`` is the list in the job store.
    ``look`` returns the present status of this process, ``None`` when it accepts no more work; it is called from the
    thread.
    """

    def __init__(self, workers: Workers, look: Callable[[], WorkerStatus | None]) -> None:
        self._workers, self._look = workers, look
        self._name = process_name()
        self._ended = threading.Event()
        self._is_reported = True
        self._thread = threading.Thread(target=self._report_until_ended, daemon=True)

    def start(self) -> None:
        """Start to report."""
        self._thread.start()

    def stop(self) -> None:
        """Remove this process from the list of workers."""
        self._ended.set()
        self._thread.join(_STOP_S)  # if the database does not respond, the row expires by itself

    def _report_until_ended(self) -> None:
        reported: WorkerStatus | None = None
        reported_s = 0.0
        while not self._ended.is_set():
            try:
                status = self._look()
            except OSError:  # such as a network folder that does not respond
                log.exception("presence_not_known")
                self._ended.wait(_REPORT_S)
                continue
            if status is None:
                break
            now_s = time.monotonic()
            if status != reported or now_s - reported_s >= _REPORT_S:
                self._try(partial(self._workers.report, status))
                reported, reported_s = status, now_s
            self._ended.wait(_LOOK_READY_S if status.state is WorkerState.READY else _LOOK_S)
        self._try(partial(self._workers.remove, [self._name]))

    def _try(self, report: Callable[[], None]) -> None:
        try:
            report()
        except SQLAlchemyError as error:
            if self._is_reported:  # logged once while the database does not respond
                log.warning("presence_not_reported", reason=type(error).__name__)
            self._is_reported = False
        else:
            self._is_reported = True
