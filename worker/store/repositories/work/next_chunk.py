"""Next chunk of a worker: shares of tenants, abilities of workers, and chunks whose tries cost their workers.

Abilities are code, graphics processor and memory. No chunk waits for an ability that no ready worker has: then every
worker that runs its code takes it.

A chunk can kill every worker that runs it, for lack of memory or by a fault of a library, and it takes a worker seconds
to start again. So each retry waits longer, and comes after the work of all tenants. The first loss may be an outage's
fault, so its retry does not wait.
"""

import math
import random
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, func, or_, select, true

from pipeline.core.options.providers import Provider
from worker.store.database.connection import lock, now, upsert
from worker.store.database.tables import chunks, jobs, turns, workers
from worker.store.model.states import AT_WORK, ChunkState, JobState
from worker.store.model.work import Ability
from worker.store.repositories.keys import count_tenants
from worker.store.repositories.work.workers import count_ready, is_ready

_NO_TURN = datetime.min.replace(tzinfo=UTC)


def next_job(
    connection: Connection, conditions: Sequence[ColumnElement[bool]] = (true(),)
) -> tuple[str, ColumnElement[bool]] | None:
    """Job of the next chunk: of the tenant with the fewest running chunks, the oldest job with a ready chunk.

    A tenant's edits of people go before its other jobs: their files take a second, and a user waits for them. The
    others are ordered by their priorities.

    Tenants with equal numbers take turns, and are ordered at random before their first one, so that a long queue of one
    tenant does not delay the others. A tenant that has its share of the workers waits, see ``has_share``. First tries
    go before retries of chunks that cost their workers, see ``retry_order``; after that chunks with the first of the
    ``conditions`` go before those with the next one. Returns the job with the condition of its chunks.
    """
    tenants = sorted({tenant for state in AT_WORK for tenant in _tenants_in(connection, state)})
    num_running = _num_running(connection)
    most = _largest_share(connection)
    in_line = retry_order(connection, tenants)
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


class MachineFull(Exception):  # noqa: N818 - no error: the chunk waits
    """The machine of a worker has no memory for one more chunk now."""


def ability_conditions(connection: Connection, ability: Ability) -> list[ColumnElement[bool]]:
    """Conditions of the chunks that a worker takes, in their order.

    While ready workers without a GPU run all other stages, a worker with a GPU takes chunks of networks first, or
    alone if it is reserved for them.
    """
    if ability.codes is None:
        return [_fits_memory(connection, ability)]
    codes = [ability.codes]
    rest = ability.codes - ability.gpu_codes
    if ability.gpu_codes and _run_without_gpu(connection, rest):
        codes = [ability.gpu_codes] if ability.reserves_gpu else [ability.gpu_codes, ability.codes]
    fits = _fits_memory(connection, ability)
    return [and_(chunks.c.code.in_(some), fits) for some in codes]


def has_others(connection: Connection, ability: Ability) -> bool:
    """Return whether a ready worker has a GPU, and this one none, or the other way round."""
    return any(provider.is_gpu != bool(ability.gpu_codes) for provider in _providers(connection))


def require_machine(connection: Connection, chunk: Row[Any], worker: str, machine_bytes: int | None) -> None:
    """Raise ``MachineFull`` if a chunk does not fit beside those that run on the worker's machine.

    A chunk that runs there alone always fits. The answer holds until the end of the transaction, which writes.
    """
    if machine_bytes is None:
        return
    host = f"{worker.rpartition(':')[0]}:"
    lock(connection, f"memory of {host}")
    running = select(func.count(), func.coalesce(func.sum(chunks.c.memory_bytes), 0)).where(
        chunks.c.state == ChunkState.RUNNING, chunks.c.worker.startswith(host, autoescape=True)
    )
    num_running, used_bytes = connection.execute(running).one()
    if num_running and int(used_bytes) + chunk.memory_bytes > machine_bytes:
        raise MachineFull


def _fits_memory(connection: Connection, ability: Ability) -> ColumnElement[bool]:
    """Condition that a chunk fits into the worker's memory, or into no ready worker's."""
    largest = connection.scalar(select(func.max(workers.c.memory_bytes)).where(is_ready())) or 0
    if ability.memory_bytes is None or ability.memory_bytes >= largest:
        return true()
    return or_(chunks.c.memory_bytes <= ability.memory_bytes, chunks.c.memory_bytes > largest)


def _run_without_gpu(connection: Connection, codes: frozenset[str]) -> bool:
    ready = connection.execute(select(workers.c.codes, workers.c.provider).where(is_ready())).all()
    run = [code for row in ready if not Provider(**row.provider).is_gpu for code in row.codes]
    return codes.issubset(run)


def _providers(connection: Connection) -> Iterator[Provider]:
    for provider in connection.scalars(select(workers.c.provider).where(is_ready())):
        yield Provider(**provider)


# Maximum number of running retries of a tenant.
_MAX_RUNNING_RETRIES = 2

# Wait before each retry, by the number of lost tries.
_WAITS_S = (0.0, 20.0, 60.0, 180.0)
# Time for which a retry comes after first tries, for each lost try: a tenant's long queue must not delay another
# tenant's work without end.
_BEHIND_S = 30.0
# A retry that has run for longer is under no suspicion: a lost lease would have been noticed.
_LIVELY_S = 30.0


def lost_try_columns(num_lost: int) -> dict[str, Any]:
    """Columns of a chunk that has lost one more try, after ``num_lost`` others."""
    return {"lost_tries": num_lost + 1, "due_at": now() + _WAITS_S[min(num_lost, len(_WAITS_S) - 1)]}


def may_retry(connection: Connection, tenant: str) -> bool:
    """Return whether a tenant may run one more retry."""
    running = select(func.count()).select_from(chunks.join(jobs)).where(jobs.c.tenant == tenant, *_is_lost())
    num_running = connection.scalar(running.where(chunks.c.state == ChunkState.RUNNING)) or 0
    return num_running < _MAX_RUNNING_RETRIES


def retry_order(connection: Connection, tenants: Collection[str]) -> list[ColumnElement[bool]]:
    """Conditions of the ready chunks that may be claimed: all of the first one go before all of the next one.

    First tries go first, except in jobs with a lost try and of tenants with two of them. Retries follow, and
    then the other first tries, which might cost a worker too: none of a job of which a chunk has lost two tries.

    ``tenants``: tenants that have work. While there are others, a tenant begins one retry at a time, and only when all
    of its lost chunks are due. With a chunk that has lost two tries it takes no idle worker, which the others will
    need: the chunk waits for its place among first tries, and the work after it waits for the chunk.
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
        if is_next and at_work[tenant] < _MAX_RUNNING_RETRIES:
            ready = [chunk for chunk in ready if chunk.due_for_s >= 0.0]
            due += [chunk.id for chunk in ready if chunk.lost_tries == 1 or not has_rivals]
            overdue += [chunk.id for chunk in ready if due_s >= _BEHIND_S * most_lost]
    suspects = [chunk for of_tenant in lost.values() for chunk in of_tenant]
    crowded = [tenant for tenant, of_tenant in lost.items() if len(of_tenant) > 1]
    is_suspect = or_(chunks.c.job_id.in_({chunk.job_id for chunk in suspects}), _is_job_of_tenants(crowded))
    is_waiting = or_(
        chunks.c.job_id.in_({chunk.job_id for chunk in suspects if chunk.lost_tries > 1}), _is_job_of_tenants(barred)
    )
    is_first_try = chunks.c.lost_tries == 0
    return [
        or_(and_(is_first_try, ~is_suspect), chunks.c.id.in_(overdue)),
        chunks.c.id.in_(due),
        and_(is_first_try, is_suspect, ~is_waiting),
    ]


def _is_lost() -> tuple[ColumnElement[bool], ...]:
    return chunks.c.lost_tries > 0, chunks.c.state.in_((ChunkState.READY, ChunkState.RUNNING))


def _is_job_of_tenants(tenants: Collection[str]) -> ColumnElement[bool]:
    of_tenants = select(jobs.c.id).where(jobs.c.tenant.in_(tenants), jobs.c.state.in_(AT_WORK))
    return chunks.c.job_id.in_(of_tenants)
