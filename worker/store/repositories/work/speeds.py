"""Speed of networks, measured on the chunks of the newest jobs."""

from statistics import median

from sqlalchemy import select

from pipeline.run.engine.stage import DETECT
from worker.store.database.tables import chunks, jobs
from worker.store.database.transactions import Transactions
from worker.store.model.states import ChunkState, JobState

# Jobs and chunks that are looked at, and the fewest chunks that tell a speed.
_MOST_JOBS, _MOST_CHUNKS, _FEWEST_CHUNKS = 20, 200, 4
# Shortest time that is measured: the clock of a database has steps.
_SHORTEST_S = 1e-5


class Speeds:
    """Speeds of all workers."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

    def frame_s(self) -> float | None:
        """Median time that networks took for a frame of a camera; ``None`` where too few chunks tell.

        Chunks count whose people were detected, whatever networks the jobs had chosen: those of the newest jobs that
        succeeded, and none whose output was there already.
        """
        newest = (
            select(jobs.c.id)
            .where(jobs.c.state == JobState.SUCCEEDED)
            .order_by(jobs.c.queued_at.desc())
            .limit(_MOST_JOBS)
            .subquery()
        )
        seconds = (chunks.c.finished_at - chunks.c.claimed_at).label("seconds")
        detected = (
            select(seconds, chunks.c.unit_count)
            .join(newest, newest.c.id == chunks.c.job_id)
            .where(
                chunks.c.stage == DETECT,
                chunks.c.state == ChunkState.DONE,
                chunks.c.reused.is_(False),
                chunks.c.claimed_at.is_not(None),
            )
            .limit(_MOST_CHUNKS)
        )
        with self._transactions.reading() as connection:
            found = connection.execute(detected).all()
        if len(found) < _FEWEST_CHUNKS:
            return None
        return max(_SHORTEST_S, median(row.seconds / row.unit_count for row in found))
