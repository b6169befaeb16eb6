"""Quotas of tenants, and how much of them is used."""

from dataclasses import asdict, dataclass

from sqlalchemy import Connection, func, select

from worker.store.database.tables import artifacts, calibrations, characters, jobs, results, sessions, uploads
from worker.store.errors import QuotaExceeded
from worker.store.model.job_records import SIDE_KINDS
from worker.store.model.rights import Usage
from worker.store.model.states import UNFINISHED, JobState


@dataclass(frozen=True, slots=True)
class Quotas:
    """Limits of each tenant; ``None``: no limit."""

    sessions: int | None = None
    unfinished_jobs: int | None = None
    stored_bytes: int | None = None
    uploads: int | None = None


NO_QUOTAS = Quotas()
_TABLES_WITH_BYTES = (sessions, calibrations, characters, uploads)


def read_usage(connection: Connection, tenant: str) -> Usage:
    """Read how much a tenant has now.

    ``stored_bytes`` counts input files of sessions, outputs of chunks, results, calibrations, characters and
    their copies of jobs, and uploads by their announced sizes.
    """
    is_kept = (jobs.c.tenant == tenant, jobs.c.state != JobState.EXPIRED)
    copied_bytes = jobs.c.character[("file", "num_bytes")].as_integer()
    sums = [
        *(select(func.sum(table.c.num_bytes)).where(table.c.tenant == tenant) for table in _TABLES_WITH_BYTES),
        select(func.sum(artifacts.c.num_bytes)).join(sessions).where(sessions.c.tenant == tenant),
        select(func.sum(results.c.num_bytes)).join(jobs).where(*is_kept),
        select(func.sum(copied_bytes)).where(*is_kept, jobs.c.reconstruction_id.is_(None)),
    ]
    num_sessions, num_uploads = (
        connection.scalar(select(func.count()).where(table.c.tenant == tenant)) or 0 for table in (sessions, uploads)
    )
    return Usage(
        sessions=num_sessions,
        unfinished_jobs=_count_unfinished(connection, tenant),
        stored_bytes=sum(int(connection.scalar(query) or 0) for query in sums),
        uploads=num_uploads,
    )


def read_unfinished(connection: Connection, tenant: str) -> Usage:
    """Read how many unfinished jobs a tenant has, without the rest: it takes no longer with many finished ones."""
    return Usage(sessions=0, unfinished_jobs=_count_unfinished(connection, tenant), stored_bytes=0, uploads=0)


def _count_unfinished(connection: Connection, tenant: str) -> int:
    """Count the unfinished jobs of a tenant, those that it asked for."""
    is_unfinished = jobs.c.state.in_(UNFINISHED), jobs.c.kind.not_in(SIDE_KINDS)
    return connection.scalar(select(func.count()).where(jobs.c.tenant == tenant, *is_unfinished)) or 0


def require_room(quotas: Quotas, used: Usage, **more: int) -> None:
    """Raise ``QuotaExceeded`` if more would exceed a quota; ``more`` has amounts by the names of quotas."""
    for name, limit in asdict(quotas).items():
        if limit is not None and more.get(name, 0) > 0 and getattr(used, name) + more[name] > limit:
            raise QuotaExceeded(name, limit, getattr(used, name))
