"""Presence of worker processes: rows in the list of workers, temporary folders, and what killed processes leave.

The first start compiles the numeric kernels, which takes some minutes. Celery would consider forked children dead while
they compile, and each child would compile all kernels. So a program of its own compiles them before the fork, and the
list of workers shows its progress. If all kernels are compiled, this takes milliseconds and imports no numeric library.
"""

import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import structlog
from sqlalchemy.exc import SQLAlchemyError

from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.kernel_cache import cache_folder, is_complete
from pipeline.core.runtime.parent_watch import tied_to_parent
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.repositories.work.workers import Workers
from worker.store.store import JobStore

_NAME = re.compile(r"multicap-(\d+)-\w+", re.ASCII)


log = structlog.get_logger()

# Installed packages of a ready process seldom change, and looking for them takes milliseconds.
_LOOK_S, _LOOK_READY_S = 0.2, 1.0
_REPORT_S = 4.0
_STOP_S = 1.0

COMPILING = "A worker compiles the numeric kernels"
_LOG_EVERY = 10


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Create a temporary folder of this process; it is removed at the end of the block."""
    with tempfile.TemporaryDirectory(prefix=f"multicap-{os.getpid()}-") as folder:
        yield Path(folder)


def remove_abandoned() -> None:
    """Remove folders of processes that have ended."""
    for folder in Path(tempfile.gettempdir()).iterdir():
        owner = _NAME.fullmatch(folder.name)
        if owner is not None and not is_running(int(owner[1])):
            shutil.rmtree(folder, ignore_errors=True)  # another process may be removing it, too


def is_running(pid: int) -> bool:
    """True if there is a process with this id."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OverflowError, PermissionError):
        return True  # a process of another user, or an id that no process can have
    return True


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

    The work continues if the database does not respond; the report is repeated. ``workers`` is the list in the job
    store. ``look`` returns the present status of this process, ``None`` when it accepts no more work; it is called from
    the thread.
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


def compile_kernels(store: JobStore) -> None:
    """Compile missing kernels, and list this process among the workers meanwhile; exit with a message on failure."""
    if is_complete():
        return
    if cache_folder() is None:
        log.warning("kernel_cache_unavailable", hint="Every worker process compiles all kernels. Set MULTICAP_HOME.")
        return
    status = WorkerStatus(process_name(), WorkerState.STARTING, COMPILING)
    presence = Presence(store.workers, lambda: status)
    presence.start()
    log.info("kernels_compiling", hint="A first start takes some minutes.")
    done = total = 0
    try:
        command = tied_to_parent(module_command("pipeline.run.warm_up", "--progress"))
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:  # noqa: S603 - our own command
            try:
                for line in program.stdout or ():
                    progress = json.loads(line)
                    done, total = progress["done"], progress["total"]
                    status = replace(status, done=min(done, total), total=total)
                    if done % _LOG_EVERY == 0:
                        log.info("kernels_compiling", done=done, total=total)
            except BaseException:  # such as SIGTERM: leaving the block would wait for the program
                program.kill()
                raise
        if program.returncode != 0:
            log.error("kernels_not_compiled", exit_code=program.returncode)
            sys.exit("error: The numeric kernels could not be compiled; without them nothing can be reconstructed.")
        log.info("kernels_compiled", done=done, total=total)
    finally:
        presence.stop()
