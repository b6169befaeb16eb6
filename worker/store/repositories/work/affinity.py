"""Affinity of machines and cameras: with a bucket, the machine that has fetched a camera's video gets its chunks.

Cameras are shared out among the machines of ready workers by their places in both lists. The shares only order the
chunks that are ready anyway: a worker whose cameras have none takes those of others, so that nothing waits.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, select

from worker.store.database.tables import chunks, workers
from worker.store.model.states import ChunkState
from worker.store.repositories.work.abilities import host_of
from worker.store.repositories.work.workers import is_ready

# Ready chunks that a worker chooses from, and chunks that tell the cameras of a stage: those of the first range come
# first, and a session has at most 31 cameras.
_CHOICE = 64


def first_chunk(connection: Connection, job_id: str, takes: ColumnElement[bool], worker: str) -> Row[Any] | None:
    """First ready chunk of a job; of a stage that is cut by camera, the first one of a camera of the worker's machine.

    ``takes`` is the condition of the chunks that the worker takes.
    """
    ready = select(chunks).where(chunks.c.job_id == job_id, chunks.c.state == ChunkState.READY, takes)
    ready = ready.order_by(chunks.c.stage_index, chunks.c.chunk_index)
    first = connection.execute(ready.limit(1)).one_or_none()
    if first is None or first.payload.get("camera") is None:
        return first
    hosts = sorted({host_of(name) for name in connection.scalars(select(workers.c.id).where(is_ready()))})
    if len(hosts) < 2 or host_of(worker) not in hosts:
        return first
    of_stage = chunks.c.job_id == job_id, chunks.c.stage_index == first.stage_index
    payloads = select(chunks.c.payload).where(*of_stage, chunks.c.chunk_index < _CHOICE).order_by(chunks.c.chunk_index)
    cameras = list(dict.fromkeys(payload["camera"] for payload in connection.scalars(payloads)))
    own = cameras_of(hosts.index(host_of(worker)), len(hosts), cameras)
    choice = connection.execute(ready.where(chunks.c.stage_index == first.stage_index).limit(_CHOICE))
    return next((chunk for chunk in choice if chunk.payload["camera"] in own), first)


def cameras_of(number: int, num_hosts: int, cameras: Sequence[str]) -> frozenset[str]:
    """Cameras of a machine, by its number: all have as many, or there are several machines to a camera.

    >>> sorted(cameras_of(1, 2, ["a", "b", "c", "d"]))
    ['b', 'd']
    >>> sorted(cameras_of(6, 8, ["a", "b", "c", "d"]))
    ['c']
    """
    if num_hosts > len(cameras):
        return frozenset({cameras[number % len(cameras)]})
    return frozenset(cameras[number::num_hosts])
