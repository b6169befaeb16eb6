"""Worker processes: whether they are alive, and could start a chunk now; and outages that work waits for.

Each process renews its own row. A row that was not renewed for a while belongs to a process that has ended.
"""

from collections.abc import Collection, Iterable
from dataclasses import asdict
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, Row, and_, case, delete, func, or_, select, update

from pipeline.core.options.providers import CPU
from pipeline.core.problems.finding_codes import WORKER_LOST
from worker.store.database.access import ServiceRepository
from worker.store.database.connection import now, upsert
from worker.store.database.rows import read
from worker.store.database.tables import chunks, failures, jobs, workers
from worker.store.database.transitions import lock_job, set_waiting
from worker.store.model.job_records import JobProblem
from worker.store.model.states import AT_WORK, ChunkState
from worker.store.model.work import Claim, WorkerState, WorkerStatus
from worker.store.outages import Outage

# Renewed every four seconds: two in a row were missed.
SILENT_AFTER_S = 10.0
_FORGOTTEN_AFTER_S = 60.0
_LISTS = ("detectors", "bodies", "formats", "codes")


class Workers(ServiceRepository):
    """Worker processes of the whole service."""

    def report(self, status: WorkerStatus) -> None:
        """Record what a worker process does now; the row is valid for ``SILENT_AFTER_S``."""
        with self._transactions.writing() as connection:
            lists = {name: list(getattr(status, name)) for name in _LISTS}
            upsert(connection, workers, asdict(status) | lists | {"seen_at": now()})
            silent = or_(workers.c.seen_at < now() - _FORGOTTEN_AFTER_S, workers.c.seen_at > now() + _FORGOTTEN_AFTER_S)
            connection.execute(delete(workers).where(silent))

    def remove(self, worker_ids: Collection[str]) -> None:
        """Delete worker processes that have ended."""
        with self._transactions.writing() as connection:
            connection.execute(delete(workers).where(workers.c.id.in_(worker_ids)))

    def all(self) -> list[WorkerStatus]:
        """Worker processes that are alive."""
        with self._transactions.reading() as connection:
            rows = connection.execute(select(workers).where(_is_alive()).order_by(workers.c.id))
            return [read(WorkerStatus, row) for row in rows]

    def provider(self, earlier: str | None = None) -> str:
        """See ``provider_at_work``."""
        return provider_at_work(self.all(), earlier)


def provider_at_work(found: Iterable[WorkerStatus], earlier: str | None = None) -> str:
    """Identity of the execution provider for which work is planned, so that a ready worker can run it.

    The provider of an ``earlier`` plan as long as a worker has it; else a GPU before the CPU, and the CPU if no worker
    is ready.
    """
    providers = {worker.provider for worker in found if worker.state is WorkerState.READY}
    if earlier is not None and earlier in {provider.identity for provider in providers}:
        return earlier
    return min(providers, key=lambda provider: (not provider.is_gpu, provider.identity), default=CPU).identity


def count_ready(connection: Connection) -> int:
    """Number of worker processes that could start a chunk now, or are at work on one."""
    ready = select(func.count()).select_from(workers).where(is_ready())
    return connection.scalar(ready) or 0


def codes_at_work(connection: Connection) -> frozenset[str]:
    """Digests of the stages' code that ready workers run, each of some worker."""
    ready = select(workers.c.codes).where(is_ready())
    return frozenset(code for codes in connection.scalars(ready) for code in codes)


def shared_by_ready(
    found: Iterable[WorkerStatus], kind: Literal["detectors", "bodies", "formats"]
) -> frozenset[str] | None:
    """Names that every ready worker lists, for any of them may take a chunk; ``None`` if no worker is ready."""
    ready = [frozenset[str](getattr(worker, kind)) for worker in found if worker.state is WorkerState.READY]
    return frozenset.intersection(*ready) if ready else None


def is_ready() -> ColumnElement[bool]:
    """Condition of the workers that could start a chunk now, or are at work on one."""
    return and_(_is_alive(), workers.c.state == WorkerState.READY)


def _is_alive() -> ColumnElement[bool]:
    # Not from the future either: where the clock was put back, such rows would never end.
    return workers.c.seen_at.between(now() - SILENT_AFTER_S, now() + SILENT_AFTER_S)


class Waits(ServiceRepository):
    """Waiting work, of all tenants. A chunk that is given back to wait is a matter of ``Leases.release``."""

    def begin_broker_outage(self, problem: JobProblem) -> None:
        """Let jobs with ready chunks wait for the broker, unless they wait for something already."""
        ready = select(chunks.c.job_id).where(chunks.c.state == ChunkState.READY)
        waiting = select(jobs.c.id).where(jobs.c.id.in_(ready), jobs.c.state.in_(AT_WORK), jobs.c.waiting_for.is_(None))
        with self._transactions.writing() as connection:
            for job in _locked(connection, list(connection.scalars(waiting.order_by(jobs.c.id)))):
                if job.waiting_for is None and job.state in AT_WORK:
                    set_waiting(connection, job, problem)

    def end_broker_outage(self) -> None:
        """Let no job wait for the broker any more."""
        waiting = select(jobs.c.id).where(jobs.c.state.in_(AT_WORK), jobs.c.waiting_for.is_not(None))
        with self._transactions.writing() as connection:
            for job in _locked(connection, list(connection.scalars(waiting.order_by(jobs.c.id)))):
                if job.waiting_for is not None and job.waiting_for["code"] == Outage.BROKER:
                    set_waiting(connection, job, None)

    def excuse(self, claim: Claim) -> None:
        """Restore the try that a chunk lost to a worker that was cut off from the database, but not lost."""
        lost = (
            select(failures.c.id, failures.c.problem)
            .where(
                failures.c.job_id == claim.job_id,
                failures.c.attempt == claim.job_attempt,
                failures.c.stage == claim.stage,
                failures.c.chunk_index == claim.index,
                failures.c.chunk_try == claim.attempt,
            )
            .order_by(failures.c.id.desc())
            .limit(1)
        )
        restore = (
            update(chunks)
            .where(chunks.c.id == claim.chunk_id, chunks.c.attempt > claim.attempt)
            .values(
                attempt=chunks.c.attempt - 1,
                lost_tries=case((chunks.c.lost_tries > 0, chunks.c.lost_tries - 1), else_=0),
                due_at=None,
            )
        )
        with self._transactions.writing() as connection:
            if lock_job(connection, claim.job_id) is None:
                return
            last = connection.execute(lost).one_or_none()
            if last is None or last.problem["code"] != WORKER_LOST:
                return
            if connection.execute(restore).rowcount == 1:
                connection.execute(delete(failures).where(failures.c.id == last.id))


def _locked(connection: Connection, job_ids: list[str]) -> list[Row[Any]]:
    """Lock jobs one after another, and return those that still exist."""
    return [job for job_id in job_ids if (job := lock_job(connection, job_id)) is not None]
