"""Changes of jobs for all event streams of this process, found by one poller."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import structlog
from starlette.concurrency import run_in_threadpool

from api.errors import ApiError
from worker.jobs.errors import DamagedDatabase, NotFound
from worker.jobs.model import FINISHED, Change, Job
from worker.jobs.store import JobStore

_log = structlog.get_logger(__name__)

_INTERVAL_S = 0.5
_RETRY_AFTER_S = 10


@dataclass(frozen=True, slots=True)
class News:
    """A job as it is now, and the id of its last event; no job if it was deleted."""

    job: Job | None
    event: int | None


@dataclass(eq=False, slots=True)
class _Watch:
    """A job as one stream sees it. A slow reader gets the latest news only."""

    owner: str
    job_id: str
    shown: Change | None
    news: asyncio.Queue[News] = field(default_factory=lambda: asyncio.Queue(1))

    def tell(self, news: News) -> None:
        with contextlib.suppress(asyncio.QueueEmpty):
            self.news.get_nowait()
        self.news.put_nowait(news)


class JobChanges:
    """Follows the jobs of open event streams.

    Parameters
    ----------
    store
        Job store.
    max_streams
        Maximum number of streams of an owner.
    """

    def __init__(self, store: JobStore, max_streams: int) -> None:
        self._store, self._max_streams = store, max_streams
        self._watches: set[_Watch] = set()
        self._somebody_watches = asyncio.Event()

    def require_room(self, owner: str) -> None:
        """Raise 429 if an owner has the maximum number of streams."""
        if sum(watch.owner == owner for watch in self._watches) >= self._max_streams:
            raise ApiError(
                "too_many_streams",
                f"At most {self._max_streams} event streams may be open.",
                hint="Close those of jobs that nobody follows any more.",
                retryable=True,
                headers={"Retry-After": str(_RETRY_AFTER_S)},
            )

    async def follow(self, owner: str, job_id: str, known: Change | None) -> AsyncIterator[News]:
        """Changes of a job, until it has ended or is deleted.

        Parameters
        ----------
        owner
            Tenant, or client without a key, that the stream belongs to.
        known
            Change that the client has seen; ``None``: the present state of the job is news.
        """
        watch = _Watch(owner, job_id, known)
        self._watches.add(watch)
        self._somebody_watches.set()
        try:
            while True:
                news = await watch.news.get()
                yield news
                if news.job is None or news.job.state in FINISHED:
                    return
        finally:
            self._watches.discard(watch)

    async def poll(self) -> None:
        """Look for changes as long as streams are open; runs until it is canceled."""
        while True:
            await self._somebody_watches.wait()
            try:
                await self._look()
            except DamagedDatabase:
                return  # there will be no changes; requests answer with the problem
            except Exception:
                # The database may be away for a while; streams wait for it.
                _log.exception("events_not_read")
            if not self._watches:
                self._somebody_watches.clear()
            await asyncio.sleep(_INTERVAL_S)

    async def _look(self) -> None:
        # Streams that open during the query wait for the next look.
        watches = list(self._watches)
        changes = await run_in_threadpool(self._store.jobs.changes, {watch.job_id for watch in watches})
        behind: dict[str, list[_Watch]] = {}
        for watch in watches:
            if watch.job_id not in changes:
                watch.tell(News(None, None))
            elif changes[watch.job_id] != watch.shown:
                behind.setdefault(watch.job_id, []).append(watch)
        for job_id, to_be_told in behind.items():
            try:
                job = await run_in_threadpool(self._store.jobs.get, job_id)
            except NotFound:  # deleted just now: the next look finds out
                continue
            for watch in to_be_told:
                watch.shown = changes[job_id]
                watch.tell(News(job, changes[job_id].event))
