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


def read_usage(connection: Connection, tenant: str) -> Usage:
    """Read how much a tenant has now.

    ``stored_bytes`` counts input files of sessions, outputs of chunks, results, calibrations, characters and
    their copies of jobs, and uploads by their announced sizes.
    """
    mine = jobs.c.tenant == tenant
    num_sessions, input_bytes = connection.execute(
        select(func.count(), func.coalesce(func.sum(sessions.c.num_bytes), 0)).where(sessions.c.tenant == tenant)
    ).one()
    found = select(func.coalesce(func.sum(artifacts.c.num_bytes), 0)).join(sessions).where(sessions.c.tenant == tenant)
    shown = (
        select(func.coalesce(func.sum(results.c.num_bytes), 0)).join(jobs).where(mine, jobs.c.state != JobState.EXPIRED)
    )
    calibrated = select(func.coalesce(func.sum(calibrations.c.num_bytes), 0)).where(calibrations.c.tenant == tenant)
    moved = select(func.coalesce(func.sum(characters.c.num_bytes), 0)).where(characters.c.tenant == tenant)
    is_copy = (mine, jobs.c.state != JobState.EXPIRED, jobs.c.reconstruction_id.is_(None))
    copied = select(func.coalesce(func.sum(jobs.c.character[("file", "num_bytes")].as_integer()), 0)).where(*is_copy)
    num_uploads, upload_bytes = connection.execute(
        select(func.count(), func.coalesce(func.sum(uploads.c.num_bytes), 0)).where(uploads.c.tenant == tenant)
    ).one()
    return Usage(
        sessions=num_sessions,
        unfinished_jobs=_count_unfinished(connection, tenant),
        stored_bytes=sum(
            int(some or 0)
            for some in (
                input_bytes,
                *(connection.scalar(query) for query in (found, shown, calibrated, moved, copied)),
                upload_bytes,
            )
        ),
        uploads=num_uploads,
    )


def read_unfinished(connection: Connection, tenant: str) -> Usage:
    """Read how many unfinished jobs a tenant has, without the rest: it takes no longer with many finished ones."""
    return Usage(sessions=0, unfinished_jobs=_count_unfinished(connection, tenant), stored_bytes=0, uploads=0)


def _count_unfinished(connection: Connection, tenant: str) -> int:
    """Count the unfinished jobs of a tenant, those that it asked for."""
    is_unfinished = jobs.c.state.in_(UNFINISHED), jobs.c.kind.not_in(SIDE_KINDS)
    return connection.scalar(select(func.count()).where(jobs.c.tenant == tenant, *is_unfinished)) or 0


def require_room(
    quotas: Quotas,
    used: Usage,
    *,
    sessions: int = 0,
    unfinished_jobs: int = 0,
    stored_bytes: int = 0,
    uploads: int = 0,
) -> None:
    """Raise ``QuotaExceeded`` if more of something would exceed a quota."""
    more = {
        "sessions": sessions,
        "unfinished_jobs": unfinished_jobs,
        "stored_bytes": stored_bytes,
        "uploads": uploads,
    }
    for name, limit in asdict(quotas).items():
        if limit is not None and more[name] > 0 and getattr(used, name) + more[name] > limit:
            raise QuotaExceeded(name, limit, getattr(used, name))
