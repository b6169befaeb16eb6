"""Totals over all jobs, counted in the transactions of the events: a crash neither doubles nor loses any.

A transaction adds to totals in the order of ``Total``, so that two transactions never wait for each other in a circle.
"""

from enum import StrEnum

from sqlalchemy import Connection, func, select

from worker.store.database.connection import add_up, now
from worker.store.database.tables import chunks, jobs, totals
from worker.store.model.states import UNFINISHED, ChunkState, JobState
from worker.store.model.work import Figures, RunningChunk


class Total(StrEnum):
    """A total; its label is named behind it."""

    LEASES_LOST = "leases_lost"  # by stage
    CHUNKS_DONE = "chunks_done"  # by stage, without those that were reused
    CHUNKS_REUSED = "chunks_reused"  # by stage
    CHUNKS_RETRIED = "chunks_retried"  # by stage
    CHUNKS_GIVEN_BACK = "chunks_given_back"  # by stage, because of an outage
    CHUNK_SECONDS = "chunk_seconds"  # by stage, of those that were done, from the first try's start
    CHUNK_UNITS = "chunk_units"  # by stage, likewise
    JOBS_ENDED = "jobs_ended"  # by state


def count(connection: Connection, total: Total, label: str, amount: float = 1.0) -> None:
    """Add an amount to a total."""
    add_up(connection, totals, {"name": total, "label": label}, "value", amount)


def read_figures(connection: Connection) -> Figures:
    """Read all totals, and how much work there is now."""
    by_state = select(jobs.c.state, func.count().label("number")).group_by(jobs.c.state)
    unfinished = select(chunks.c.state, func.count().label("number")).join(jobs).where(jobs.c.state.in_(UNFINISHED))
    running = (
        select(
            jobs.c.tenant,
            chunks.c.job_id,
            chunks.c.stage,
            chunks.c.chunk_index,
            now() - chunks.c.claimed_at,
            now() - chunks.c.moved_at,
            1.0 * chunks.c.done_units / chunks.c.unit_count,
        )
        .join(jobs)
        .where(chunks.c.state == ChunkState.RUNNING, chunks.c.moved_at.is_not(None))
    )
    waiting = select(func.max(now() - jobs.c.queued_at)).where(jobs.c.state == JobState.QUEUED)
    return Figures(
        totals={(row.name, row.label): row.value for row in connection.execute(select(totals))},
        jobs={row.state: row.number for row in connection.execute(by_state)},
        chunks={
            row.state: row.number
            for row in connection.execute(unfinished.group_by(chunks.c.state))
            if row.state in {ChunkState.WAITING, ChunkState.READY, ChunkState.RUNNING}
        },
        longest_queued_s=max(0.0, connection.scalar(waiting) or 0.0),
        running=[RunningChunk(*row) for row in connection.execute(running)],
    )
