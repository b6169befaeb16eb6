"""Abilities of workers: the chunks that a worker takes, by code, graphics processor and memory.

No chunk waits for an ability that no ready worker has: then every worker that runs its code takes it.
"""

from collections.abc import Iterator
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, func, or_, select, true

from pipeline.core.options.providers import Provider
from worker.store.database.connection import lock
from worker.store.database.tables import chunks, workers
from worker.store.model.states import ChunkState
from worker.store.model.work import Ability
from worker.store.repositories.work.workers import is_ready


class MachineFull(Exception):  # noqa: N818 - no error: the chunk waits
    """The machine of a worker has no memory for one more chunk now."""


def turns(connection: Connection, ability: Ability) -> list[ColumnElement[bool]]:
    """Conditions of the chunks that a worker takes: of the first one before those of the next one.

    While ready workers without a GPU run all other stages, a worker with a GPU takes chunks of networks first, or
    alone if it is reserved for them.
    """
    if ability.codes is None:
        return [_of_memory(connection, ability)]
    codes = [ability.codes]
    rest = ability.codes - ability.gpu_codes
    if ability.gpu_codes and _run_without_gpu(connection, rest):
        codes = [ability.gpu_codes] if ability.reserves_gpu else [ability.gpu_codes, ability.codes]
    fits = _of_memory(connection, ability)
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


def _of_memory(connection: Connection, ability: Ability) -> ColumnElement[bool]:
    """Condition that a chunk fits into the worker's memory, or into that of no ready worker."""
    largest = connection.scalar(select(func.max(workers.c.memory_bytes)).where(is_ready())) or 0
    if ability.memory_bytes is None or ability.memory_bytes >= largest:
        return true()
    return or_(chunks.c.memory_bytes <= ability.memory_bytes, chunks.c.memory_bytes > largest)


def _run_without_gpu(connection: Connection, codes: frozenset[str]) -> bool:
    """Return whether ready workers without a GPU run all of some code."""
    ready = connection.execute(select(workers.c.codes, workers.c.provider).where(is_ready())).all()
    run = [code for row in ready if not Provider(**row.provider).is_gpu for code in row.codes]
    return codes.issubset(run)


def _providers(connection: Connection) -> Iterator[Provider]:
    for provider in connection.scalars(select(workers.c.provider).where(is_ready())):
        yield Provider(**provider)
