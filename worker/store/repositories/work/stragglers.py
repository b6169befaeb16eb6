"""Stragglers: chunks that take much longer than others of their stage, which an idle worker begins a second time.

The first worker to finish counts; both compute the same bytes (Dean and Ghemawat 2004, section 3.6, "backup tasks").
"""

from statistics import median
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, select, true

from worker.store.database.connection import now
from worker.store.database.tables import chunks
from worker.store.model.states import ChunkState

# A straggler has taken so many times as long as the median of its peers, for each unit, and at least so many seconds.
SLOWER, SHORTEST_S = 3.0, 5.0
# Finished chunks of the same job and stage that it is compared with; with fewer than the former none is a straggler.
_FEWEST_PEERS, _MOST_PEERS = 3, 99


def find_straggler(
    connection: Connection, worker: str = "", takes: ColumnElement[bool] | None = None
) -> Row[Any] | None:
    """Chunk that runs for longest of all stragglers without a second worker; ``None`` if there is none.

    Parameters
    ----------
    worker
        Worker that looks for it: not its own chunk.
    takes
        Condition of the chunks that the worker takes; ``None``: any.
    """
    age_s = (now() - chunks.c.claimed_at).label("age_s")
    running = select(chunks, age_s).where(
        chunks.c.state == ChunkState.RUNNING,
        chunks.c.copy_token.is_(None),
        chunks.c.lost_tries == 0,
        chunks.c.worker != worker,
        chunks.c.claimed_at < now() - SHORTEST_S,
        true() if takes is None else takes,
    )
    for chunk in connection.execute(running.order_by(chunks.c.claimed_at)):
        unit_s = _unit_seconds(connection, chunk)
        if unit_s is not None and chunk.age_s > SLOWER * unit_s * chunk.unit_count:
            return chunk
    return None


def _unit_seconds(connection: Connection, chunk: Row[Any]) -> float | None:
    """Median time of a unit of a chunk's peers in seconds; ``None`` if too few have finished."""
    seconds = (chunks.c.finished_at - chunks.c.claimed_at).label("seconds")
    peers = select(seconds, chunks.c.unit_count).where(
        chunks.c.job_id == chunk.job_id,
        chunks.c.stage_index == chunk.stage_index,
        chunks.c.state == ChunkState.DONE,
        chunks.c.reused.is_(False),
        chunks.c.claimed_at.is_not(None),
    )
    found = connection.execute(peers.order_by(chunks.c.chunk_index.desc()).limit(_MOST_PEERS)).all()
    if len(found) < _FEWEST_PEERS:
        return None
    return median(peer.seconds / peer.unit_count for peer in found)
