"""Changes of jobs for the event streams of this process, read from the database by one poller."""

import asyncio
import contextlib
import weakref
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import structlog
from starlette.concurrency import run_in_threadpool

from api.web.errors import ApiError
from pipeline.core.problems.request_codes import TOO_MANY_STREAMS
from worker.store.errors import DamagedDatabase, NotFound
from worker.store.model.job_records import JobRecord
from worker.store.model.states import FINISHED
from worker.store.model.work import Change
from worker.store.store import JobStore

_log = structlog.get_logger(__name__)

_INTERVAL_S = 0.5
_RETRY_AFTER_S = 10


@dataclass(frozen=True, slots=True)
class JobUpdate:
    """Current state of a job with the number of its last event; both are ``None`` if the job was deleted."""

    job: JobRecord | None
    event: int | None


@dataclass(eq=False, slots=True, weakref_slot=True)
class Watch:
    """Subscription of a stream to a job. A slow reader gets the latest update only."""

    owner: str
    job_id: str
    last_change: Change | None = None  # Last change that the stream knows; without it the current state comes first
    updates: asyncio.Queue[JobUpdate] = field(default_factory=lambda: asyncio.Queue(1))

    def put(self, update: JobUpdate) -> None:
        """Replace the update that waits."""
        with contextlib.suppress(asyncio.QueueEmpty):
            self.updates.get_nowait()
        self.updates.put_nowait(update)


class JobChanges:
    """Polls the watched jobs and passes their changes to event streams.

    An owner may have ``max_streams`` open streams.
    """

    def __init__(self, store: JobStore, max_streams: int) -> None:
        self._store, self._max_streams = store, max_streams
        self._watches: set[Watch] = set()
        # Also streams whose response has not begun; one that never begins is dropped with its response.
        self._open: weakref.WeakSet[Watch] = weakref.WeakSet()
        self._is_watched = asyncio.Event()

    def open(self, owner: str, job_id: str) -> Watch:
        """Take a stream of an owner, a tenant or the network of a client without a key; 429 if it has all of its own.

        The stream is given back when ``follow`` ends, or when the watch is dropped.
        """
        if sum(watch.owner == owner for watch in self._open) >= self._max_streams:
            raise ApiError(
                TOO_MANY_STREAMS,
                f"At most {self._max_streams} event streams may be open.",
                hint="Close the streams of jobs that are no longer followed.",
                retryable=True,
                headers={"Retry-After": str(_RETRY_AFTER_S)},
            )
        watch = Watch(owner, job_id)
        self._open.add(watch)
        return watch

    async def follow(self, watch: Watch) -> AsyncIterator[JobUpdate]:
        """Yield the updates of a job until it and its files are at rest, or it was deleted."""
        self._watches.add(watch)
        self._is_watched.set()
        try:
            while True:
                update = await watch.updates.get()
                yield update
                if update.job is None or update.job.attempt_state in FINISHED:
                    return
        finally:
            self._watches.discard(watch)
            self._open.discard(watch)

    async def poll(self) -> None:
        """Poll the database as long as a job is watched; runs until it is canceled."""
        while True:
            await self._is_watched.wait()
            try:
                await self._poll_once()
            except DamagedDatabase:
                return  # there will be no updates; requests report the damage
            except Exception:
                # The database may be unreachable for a while; streams wait for it.
                _log.exception("events_not_read")
            if not self._watches:
                self._is_watched.clear()
            await asyncio.sleep(_INTERVAL_S)

    async def _poll_once(self) -> None:
        # Streams that are opened during the query wait for the next poll.
        watches = list(self._watches)
        changes = await run_in_threadpool(self._store.jobs.changes, {watch.job_id for watch in watches})
        outdated: dict[str, list[Watch]] = {}
        for watch in watches:
            if watch.job_id not in changes:
                watch.put(JobUpdate(None, None))
            elif changes[watch.job_id] != watch.last_change:
                outdated.setdefault(watch.job_id, []).append(watch)
        for job_id, job_watches in outdated.items():
            try:
                job = await run_in_threadpool(self._store.jobs.get, job_id)
            except NotFound:  # deleted since the query: the next poll reports it
                continue
            for watch in job_watches:
                watch.last_change = changes[job_id]
                watch.put(JobUpdate(job, changes[job_id].event))
