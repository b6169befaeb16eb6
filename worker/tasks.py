"""The one task: work on whatever is ready."""

import functools
import mmap
import os
import signal
import threading
import time

import structlog

from worker.jobs.artifacts import ArtifactStore
from worker.jobs.queue import WorkQueue
from worker.jobs.store import JobStore
from worker.runner import Runner
from worker.settings import WorkerSettings

log = structlog.get_logger()

_SWEEP_INTERVAL_S = 600.0


class ForkedFlag:
    """A flag that the main process sets and its forked children see.

    It has no lock, so a child that was killed can't hold it, and a signal handler may set it.
    """

    def __init__(self) -> None:
        self._byte = mmap.mmap(-1, 1)

    def set(self) -> None:
        """Set it for good."""
        self._byte[0] = 1

    def is_set(self) -> bool:
        """Whether anybody set it."""
        return self._byte[0] == 1


shutting_down = ForkedFlag()


@functools.cache
def process_runner() -> Runner:
    """Connect this process to the store and load the science, once."""
    # The main process never loads it: its children are forked, and libraries with threads don't survive that.
    from worker.stages import STAGES, warm_up  # noqa: PLC0415

    warm_up()
    settings = WorkerSettings()
    artifacts = settings.open_artifacts()
    threading.Thread(target=_sweep_forever, args=[artifacts], daemon=True).start()
    return Runner(
        store=JobStore(settings.resolved_database_url),
        artifacts=artifacts,
        publish=WorkQueue(settings.broker_url).publish,
        stages=STAGES,
        lease_s=settings.lease_s,
        heartbeat_s=settings.heartbeat_s,
        stopping=shutting_down.is_set,
        on_stuck=_end_process,
    )


def work() -> None:
    """Run ready chunks until there are none."""
    process_runner().work(WorkerSettings().claim_for_s)


def _sweep_forever(artifacts: ArtifactStore) -> None:
    # Also while there is no work: what was deleted in a distant store must not stay here.
    while True:
        try:
            artifacts.sweep()
        except OSError:
            log.exception("sweep_failed")
        time.sleep(_SWEEP_INTERVAL_S)


def _end_process() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
