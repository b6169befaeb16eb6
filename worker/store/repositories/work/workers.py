"""Worker processes: whether they are alive, and whether they could start a chunk now.

Each process renews its own row. A row that was not renewed for a while belongs to a process that has ended.
"""

from collections.abc import Collection, Iterable
from dataclasses import asdict

from sqlalchemy import ColumnElement, Connection, and_, delete, func, or_, select

from pipeline.core.options.providers import CPU
from worker.store.database.access import Transactions
from worker.store.database.connection import now, upsert
from worker.store.database.rows import read
from worker.store.database.tables import workers
from worker.store.model.work import WorkerState, WorkerStatus

# Renewed every four seconds: two in a row were missed.
SILENT_AFTER_S = 10.0
_FORGOTTEN_AFTER_S = 60.0
_LISTS = ("detectors", "bodies", "formats", "codes")


class Workers:
    """Worker processes of the whole service."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

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


def installed_detectors(found: Iterable[WorkerStatus]) -> frozenset[str] | None:
    """Detectors that every ready worker has, for any of them may take a chunk; ``None`` if no worker is ready."""
    return _of_all_ready((worker.state, worker.detectors) for worker in found)


def installed_bodies(found: Iterable[WorkerStatus]) -> frozenset[str] | None:
    """Bodies of people that every ready worker has installed; ``None`` if no worker is ready."""
    return _of_all_ready((worker.state, worker.bodies) for worker in found)


def writable_formats(found: Iterable[WorkerStatus]) -> frozenset[str] | None:
    """Formats of people's files that every ready worker can write; ``None`` if no worker is ready."""
    return _of_all_ready((worker.state, worker.formats) for worker in found)


def _of_all_ready(found: Iterable[tuple[WorkerState, tuple[str, ...]]]) -> frozenset[str] | None:
    ready = [frozenset(names) for state, names in found if state is WorkerState.READY]
    return frozenset.intersection(*ready) if ready else None


def is_ready() -> ColumnElement[bool]:
    """Condition of the workers that could start a chunk now, or are at work on one."""
    return and_(_is_alive(), workers.c.state == WorkerState.READY)


def _is_alive() -> ColumnElement[bool]:
    # Not from the future either: where the clock was put back, such rows would never end.
    return workers.c.seen_at.between(now() - SILENT_AFTER_S, now() + SILENT_AFTER_S)
