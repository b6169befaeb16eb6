"""Task of the workers: run ready chunks. Also what a worker process loads, and the state that it reports."""

import contextlib
import faulthandler
import functools
import mmap
import os
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import structlog
from sqlalchemy.exc import SQLAlchemyError

from pipeline.core.options.config import Body
from pipeline.core.options.file_formats import installed_formats
from pipeline.core.runtime.kernel_cache import is_complete
from pipeline.detection.providers.find import current_provider
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.plan import STAGES
from pipeline.run.engine.stage import Output
from worker.run.chunk import STOP_GRACE_S, Work, time_limit_s
from worker.run.presence import COMPILING, Presence, process_name, remove_killed
from worker.run.runner import Runner
from worker.run.settings import WorkerSettings
from worker.store.errors import DamagedDatabase
from worker.store.files.artifacts import ArtifactStore
from worker.store.files.disk import DiskSpace
from worker.store.model.work import Ability, WorkerState, WorkerStatus
from worker.store.queue import Queue, WorkQueue
from worker.store.store import JobStore

log = structlog.get_logger()

_SWEEP_INTERVAL_S = 600.0

_STDERR = 2  # Celery replaces ``sys.stderr`` by its log

LOADING, CONNECTING = "A worker loads its libraries", "A worker connects to the broker"
NO_ROOM = "A worker has no free space on its disk"
FAILED = "A worker can't load its libraries; its log says why"
WORKING = "A worker works on ready chunks"


# Set when this process could not load its libraries. Celery forks another process in its place when it ends.
_failed = threading.Event()

# Share of the memory that chunks may use: the rest is for the system, and for code.
_MEMORY_SHARE = 0.9
_CGROUPS = Path("/sys/fs/cgroup")
_PROCESS_GROUP = Path("/proc/self/cgroup")


class ForkedFlag:
    """Flag that the main process sets and its forked children see.

    It has no lock, so that a killed child can't hold a lock, and a signal handler may set it.
    """

    def __init__(self) -> None:
        self._byte = mmap.mmap(-1, 1)

    def set(self) -> None:
        """Set the flag; it is never cleared."""
        self._byte[0] = 1

    def is_set(self) -> bool:
        """True if the flag is set."""
        return self._byte[0] == 1


shutting_down = ForkedFlag()
# Set when the main process receives messages from the broker: a loaded child can get work.
consuming = ForkedFlag()


def load() -> None:
    """Load the pipeline; a failure is logged and reported in the list of workers."""
    try:
        process_runner()
    except Exception:
        _failed.set()
        log.exception("worker_not_loaded")
        raise


@functools.cache
def process_runner() -> Runner:
    """Connect this process to the store and load the pipeline, once."""
    # The main process never loads it, because libraries with threads don't survive a fork.
    from worker.run.execution import run_chunk, warm_up  # noqa: PLC0415

    warm_up()
    settings = WorkerSettings()
    artifacts = settings.open_artifacts()
    threading.Thread(target=_sweep_forever, args=[artifacts], daemon=True).start()
    queue = WorkQueue(settings.broker_url)
    return Runner(
        store=JobStore(settings.resolved_database_url),
        artifacts=artifacts,
        publish=queue.publish,
        run=_watched(run_chunk, settings.chunk_time_factor),
        lease_s=settings.lease_s,
        heartbeat_s=settings.heartbeat_s,
        stopping=shutting_down.is_set,
        on_stuck=_end_process,
        has_room=_disk().has_room,
        ability=_ability(settings),
        chunk_time_factor=settings.chunk_time_factor,
        pass_on=partial(queue.publish, Queue.CPU if current_provider().is_gpu else Queue.GPU),
    )


def _watched(run: Callable[[Work], Output], factor: float) -> Callable[[Work], Output]:
    """Let a chunk end its process after its time limit even if it never lets Python's other threads run."""

    def run_watched(work: Work) -> Output:
        limit_s = time_limit_s(work.claim.unit_count, factor) + 2 * STOP_GRACE_S
        faulthandler.dump_traceback_later(limit_s, exit=True, file=_STDERR)
        try:
            return run(work)
        finally:
            faulthandler.cancel_dump_traceback_later()

    return run_watched


def _ability(settings: WorkerSettings) -> Ability:
    provider = current_provider()
    codes = stage_codes(provider.identity)
    of_networks = {stage.name for stage in STAGES if stage.runs_networks}
    return Ability(
        codes=frozenset(codes.values()),
        gpu_codes=frozenset(codes[name] for name in of_networks) if provider.is_gpu else frozenset(),
        reserves_gpu=settings.reserve_gpu,
        memory_bytes=settings.memory_bytes,
        machine_bytes=settings.machine_memory_bytes or machine_memory_bytes(),
    )


@functools.cache
def _disk() -> DiskSpace:
    settings = WorkerSettings()
    return DiskSpace(settings.data_dir, settings.headroom_bytes)


def is_loaded() -> bool:
    """True if this process has loaded the pipeline."""
    return process_runner.cache_info().currsize > 0


def report_loading() -> None:
    """List the main process among the workers until its children list themselves."""
    store = JobStore(WorkerSettings().resolved_database_url)
    with contextlib.suppress(SQLAlchemyError):  # the database may start later
        remove_killed(store.workers)
        store.workers.report(WorkerStatus(process_name(), WorkerState.STARTING, LOADING))
    store.close()  # before children are forked


def start_presence() -> Presence:
    """List this process among the workers from now on, with its state."""
    store = JobStore(WorkerSettings().resolved_database_url)
    presence = Presence(store.workers, _status)
    presence.start()
    return presence


def _status() -> WorkerStatus | None:
    if shutting_down.is_set():
        return None
    if _failed.is_set():
        return WorkerStatus(process_name(), WorkerState.STARTING, FAILED)
    if not is_loaded():
        activity = LOADING if is_complete() else COMPILING
        return WorkerStatus(process_name(), WorkerState.STARTING, activity)
    if not consuming.is_set():
        return WorkerStatus(process_name(), WorkerState.STARTING, CONNECTING)
    if not _disk().has_room():
        return WorkerStatus(process_name(), WorkerState.STARTING, NO_ROOM)
    provider = current_provider()
    codes = tuple(sorted(stage_codes(provider.identity).values()))
    return WorkerStatus(
        process_name(),
        WorkerState.READY,
        WORKING,
        detectors=_installed_detectors(),
        bodies=_installed_bodies(),
        formats=installed_formats(),
        codes=codes,
        provider=provider,
        memory_bytes=WorkerSettings().memory_bytes,
    )


def _installed_detectors() -> tuple[str, ...]:
    # Read each time, because a detector may be installed while the worker runs.
    from pipeline.detection.models import status  # noqa: PLC0415 - see `process_runner`

    return tuple(model.name for model in status() if model.installed)


def _installed_bodies() -> tuple[Body, ...]:
    from pipeline.motion.body.installed import is_installed  # noqa: PLC0415 - see `process_runner`

    return ("human",) if is_installed() else ()


def work(is_for_all: bool) -> None:
    """Run ready chunks until no chunk is ready; the message that woke this process may be one for all workers."""
    try:
        process_runner().work(WorkerSettings().claim_for_s, is_for_all)
    except DamagedDatabase as error:
        log.error("database_damaged", detail=str(error), instructions=error.instructions())  # noqa: TRY400 - the instructions are the message


def _sweep_forever(artifacts: ArtifactStore) -> None:
    # Local copies of files that were deleted in the bucket are removed even while there is no work.
    while True:
        try:
            artifacts.sweep()
        except OSError:
            log.exception("sweep_failed")
        time.sleep(_SWEEP_INTERVAL_S)


def _end_process() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def machine_memory_bytes(cgroups: Path = _CGROUPS, process_group: Path = _PROCESS_GROUP) -> int:
    """Memory for all chunks at once: nine tenths of the machine's, or of the least limit of the process's cgroups.

    ``cgroups``, ``process_group``: folder of cgroups (version 2), and file that names the cgroup of this process.
    """
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    try:
        (name,) = (line[len("0::/") :] for line in process_group.read_text().splitlines() if line.startswith("0::/"))
    except (OSError, ValueError):  # no Linux, or cgroups of version 1
        name = ""
    group = cgroups / name
    for folder in (group, *group.parents):
        try:
            limits.append(int((folder / "memory.max").read_text()))
        except (OSError, ValueError):  # the root has no limit; others have "max"
            continue
    return int(_MEMORY_SHARE * min(limits))
