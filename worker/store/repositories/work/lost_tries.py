"""Chunks whose tries cost their workers: each retry waits longer, and stands behind the work of all tenants.

A chunk can kill every worker that runs it, for lack of memory or by a fault of a library, and it takes a worker seconds
to start again. The first loss may be an outage's fault, so its retry does not wait.
"""

from collections import Counter, defaultdict
from collections.abc import Collection
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, func, or_, select, true

from worker.store.database.connection import now
from worker.store.database.tables import chunks, jobs
from worker.store.model.states import AT_WORK, ChunkState

MAX_RUNNING = 2
"""Maximum number of running retries of a tenant."""

# Wait before each retry, by the number of lost tries.
_WAITS_S = (0.0, 20.0, 60.0, 180.0)
# Time for which a retry stands behind first tries, for each lost try: a tenant's long queue must not delay another
# tenant's work without end.
_BEHIND_S = 30.0
# A retry that has run for longer is under no suspicion: a lost lease would have been noticed.
_LIVELY_S = 30.0


def lost_again(num_lost: int) -> dict[str, Any]:
    """Columns of a chunk that has lost one more try, after ``num_lost`` others."""
    return {"lost_tries": num_lost + 1, "due_at": now() + _WAITS_S[min(num_lost, len(_WAITS_S) - 1)]}


def num_running(connection: Connection, tenant: str) -> int:
    """Number of a tenant's running retries."""
    running = select(func.count()).select_from(chunks.join(jobs)).where(jobs.c.tenant == tenant, *_is_lost())
    return connection.scalar(running.where(chunks.c.state == ChunkState.RUNNING)) or 0


def lines(connection: Connection, tenants: Collection[str]) -> list[ColumnElement[bool]]:
    """Conditions of the ready chunks that may be claimed: all of the first one go before all of the next one.

    First tries go first, except in jobs with a lost try and of tenants with two of them. Retries follow, and
    then the other first tries, which might cost a worker too: none of a job of which a chunk has lost two tries.

    Parameters
    ----------
    tenants
        Tenants that have work. While there are others, a tenant begins one retry at a time, and only when all of its
        lost chunks are due. With a chunk that has lost two tries it takes no idle worker, which the others will need:
        the chunk waits for its place among first tries, and what stands behind waits for the chunk.
    """
    due_for_s = (now() - func.coalesce(chunks.c.due_at, 0.0)).label("due_for_s")
    run_for_s = (now() - chunks.c.claimed_at).label("run_for_s")
    columns = chunks.c.id, chunks.c.job_id, chunks.c.state, chunks.c.lost_tries, jobs.c.tenant, due_for_s, run_for_s
    lost: dict[str, list[Row[Any]]] = defaultdict(list)
    at_work: Counter[str] = Counter()
    for chunk in connection.execute(select(*columns).join(jobs).where(*_is_lost())):
        at_work[chunk.tenant] += chunk.state == ChunkState.RUNNING
        if chunk.state == ChunkState.READY or chunk.run_for_s < _LIVELY_S:
            lost[chunk.tenant].append(chunk)
    if not lost:
        return [true()]
    due, overdue, barred = list[int](), list[int](), list[str]()
    for tenant, of_tenant in lost.items():
        has_rivals = any(other != tenant for other in tenants)
        ready = [chunk for chunk in of_tenant if chunk.state == ChunkState.READY]
        due_s = min(chunk.due_for_s for chunk in of_tenant)
        most_lost = max(chunk.lost_tries for chunk in of_tenant)
        if has_rivals and most_lost > 1:
            barred.append(tenant)
        is_next = not has_rivals or (len(ready) == len(of_tenant) and due_s >= 0.0)
        if is_next and at_work[tenant] < MAX_RUNNING:
            ready = [chunk for chunk in ready if chunk.due_for_s >= 0.0]
            due += [chunk.id for chunk in ready if chunk.lost_tries == 1 or not has_rivals]
            overdue += [chunk.id for chunk in ready if due_s >= _BEHIND_S * most_lost]
    suspects = [chunk for of_tenant in lost.values() for chunk in of_tenant]
    crowded = [tenant for tenant, of_tenant in lost.items() if len(of_tenant) > 1]
    is_suspect = or_(chunks.c.job_id.in_({chunk.job_id for chunk in suspects}), _is_of(crowded))
    is_waiting = or_(chunks.c.job_id.in_({chunk.job_id for chunk in suspects if chunk.lost_tries > 1}), _is_of(barred))
    is_first_try = chunks.c.lost_tries == 0
    return [
        or_(and_(is_first_try, ~is_suspect), chunks.c.id.in_(overdue)),
        chunks.c.id.in_(due),
        and_(is_first_try, is_suspect, ~is_waiting),
    ]


def _is_lost() -> tuple[ColumnElement[bool], ...]:
    return chunks.c.lost_tries > 0, chunks.c.state.in_((ChunkState.READY, ChunkState.RUNNING))


def _is_of(tenants: Collection[str]) -> ColumnElement[bool]:
    of_tenants = select(jobs.c.id).where(jobs.c.tenant.in_(tenants), jobs.c.state.in_(AT_WORK))
    return chunks.c.job_id.in_(of_tenants)
