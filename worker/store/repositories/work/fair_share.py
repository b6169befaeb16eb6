"""Turns of tenants: the job whose chunk a free worker takes next."""

import math
import random
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime

from sqlalchemy import ColumnElement, Connection, and_, func, select, true

from worker.store.database.connection import lock, now, upsert
from worker.store.database.tables import chunks, jobs, turns
from worker.store.model.states import AT_WORK, ChunkState, JobState
from worker.store.repositories.rights.keys import count_tenants
from worker.store.repositories.work.lost_tries import lines
from worker.store.repositories.work.workers import count_ready

_NO_TURN = datetime.min.replace(tzinfo=UTC)


def next_job(
    connection: Connection, conditions: Sequence[ColumnElement[bool]] = (true(),)
) -> tuple[str, ColumnElement[bool]] | None:
    """Job of the next chunk: of the tenant with the fewest running chunks, the oldest job with a ready chunk.

    A tenant's edits of people go before its other jobs: their files take a second, and a user waits for them. The
    others are ordered by their priorities.

    Tenants with equal numbers take turns, and are ordered at random before their first one, so that a long queue of one
    tenant does not delay the others. A tenant that has its share of the workers waits, see ``has_share``. First tries
    go before retries of chunks that cost their workers, see ``lost_tries``; after that chunks with the first of the
    ``conditions`` go before those with the next one. Returns the job with the condition of its chunks.
    """
    tenants = sorted({tenant for state in AT_WORK for tenant in _tenants_in(connection, state)})
    num_running = _num_running(connection)
    most = _largest_share(connection)
    in_line = lines(connection, tenants)
    random.shuffle(tenants)
    recorded = connection.execute(select(turns).where(turns.c.tenant.in_(tenants)))
    last_turns = {turn.tenant: turn.claimed_at for turn in recorded}
    tenants = sorted(
        (tenant for tenant in tenants if num_running[tenant] < most),
        key=lambda tenant: (num_running[tenant], last_turns.get(tenant, _NO_TURN)),
    )
    for line in in_line:
        for condition in conditions:
            takes = and_(line, condition)
            for tenant in tenants:
                if (job_id := _oldest_with_work(connection, tenant, takes)) is not None:
                    return job_id, takes
    return None


def take_turn(connection: Connection, tenant: str) -> None:
    """Record that a tenant has had its turn; its workers are locked, see ``has_share``."""
    upsert(connection, turns, {"tenant": tenant, "claimed_at": now()})


def has_share(connection: Connection, tenant: str) -> bool:
    """Return whether a tenant may have one more running chunk.

    If several tenants have keys, one worker stays free for the others: a chunk may take minutes. The answer holds until
    the end of the transaction, which writes.
    """
    lock(connection, f"workers of {tenant}")
    return _num_running(connection)[tenant] < _largest_share(connection)


def _num_running(connection: Connection) -> Counter[str]:
    """Number of running chunks by tenant."""
    running = select(jobs.c.tenant).join(chunks).where(chunks.c.state == ChunkState.RUNNING)
    return Counter(connection.scalars(running))


def _largest_share(connection: Connection) -> float:
    """Number of running chunks that one tenant may have."""
    if count_tenants(connection) < 2 or (num_workers := count_ready(connection)) == 0:
        return math.inf
    return max(1, num_workers - 1)


def _tenants_in(connection: Connection, state: JobState) -> Sequence[str]:
    """Tenants that have jobs in a state, found by one step in the index for each, however long the queue is."""
    in_state = select(func.min(jobs.c.tenant).label("tenant")).where(jobs.c.state == state)
    tenants = in_state.cte("tenants", recursive=True)
    behind = in_state.where(jobs.c.tenant > tenants.c.tenant).correlate(tenants).scalar_subquery()
    tenants = tenants.union_all(select(behind).where(tenants.c.tenant.is_not(None)))
    return connection.scalars(select(tenants.c.tenant).where(tenants.c.tenant.is_not(None))).all()


def _oldest_with_work(connection: Connection, tenant: str, takes: ColumnElement[bool]) -> str | None:
    """Oldest job of a tenant with a ready chunk, by precedence; running jobs are older than queued ones."""
    ready = select(chunks.c.id).where(chunks.c.job_id == jobs.c.id, chunks.c.state == ChunkState.READY, takes)
    # Looked up job by job until one has a chunk: PostgreSQL makes a join of EXISTS, and reads the whole queue for it.
    has_ready = ready.limit(1).scalar_subquery().is_not(None)
    found: list[tuple[int, int, str]] = []
    # One state at a time: the index has its jobs in order, so that a long queue is not sorted.
    for place, state in enumerate((JobState.RUNNING, JobState.QUEUED)):
        of_state = select(jobs.c.precedence, jobs.c.id).where(jobs.c.state == state, jobs.c.tenant == tenant, has_ready)
        oldest = of_state.order_by(jobs.c.precedence, jobs.c.queued_at, jobs.c.id).limit(1)
        found += [(precedence, place, job_id) for precedence, job_id in connection.execute(oldest)]
    return min(found)[-1] if found else None
