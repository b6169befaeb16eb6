"""How much a tenant may have, and how much it has."""

from dataclasses import asdict, dataclass

from sqlalchemy import Connection, func, select

from worker.jobs.errors import QuotaExceeded
from worker.jobs.model import FINISHED, JobState, Usage
from worker.jobs.tables import artifacts, jobs, results, sessions


@dataclass(frozen=True, slots=True)
class Quotas:
    """How much each tenant may have; ``None``: as much as there is room for."""

    sessions: int | None = None
    unfinished_jobs: int | None = None
    stored_bytes: int | None = None


def read_usage(connection: Connection, tenant: str) -> Usage:
    """How much a tenant has now: ``stored_bytes`` of its sessions' files, what was found in them, and results."""
    mine = jobs.c.tenant == tenant
    num_sessions, input_bytes = connection.execute(
        select(func.count(), func.coalesce(func.sum(sessions.c.num_bytes), 0)).where(sessions.c.tenant == tenant)
    ).one()
    found = select(func.coalesce(func.sum(artifacts.c.num_bytes), 0)).join(sessions).where(sessions.c.tenant == tenant)
    shown = (
        select(func.coalesce(func.sum(results.c.num_bytes), 0)).join(jobs).where(mine, jobs.c.state != JobState.EXPIRED)
    )
    unfinished = select(func.count()).select_from(jobs).where(mine, jobs.c.state.not_in(FINISHED))
    return Usage(
        sessions=num_sessions,
        unfinished_jobs=connection.scalar(unfinished) or 0,
        stored_bytes=int(input_bytes) + int(connection.scalar(found) or 0) + int(connection.scalar(shown) or 0),
    )


def require_room(
    quotas: Quotas, used: Usage, *, sessions: int = 0, unfinished_jobs: int = 0, stored_bytes: int = 0
) -> None:
    """Raise ``QuotaExceeded`` if a tenant that has so much may not have so much more."""
    more = {"sessions": sessions, "unfinished_jobs": unfinished_jobs, "stored_bytes": stored_bytes}
    for name, limit in asdict(quotas).items():
        if limit is not None and more[name] > 0 and getattr(used, name) + more[name] > limit:
            raise QuotaExceeded(name, limit, getattr(used, name))
