"""Outputs of finished chunks. They stay with the session, so that its other jobs can reuse them."""

from sqlalchemy import select

from worker.store.database.tables import artifacts, chunks, jobs
from worker.store.database.transactions import Transactions
from worker.store.model.work import ChunkOutput


class Outputs:
    """Outputs of all sessions."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions

    def find(self, session_id: str, output_key: str) -> tuple[str, int] | None:
        """SHA-256 and size in bytes of a chunk's output if any job of the session has finished the chunk."""
        query = select(artifacts.c.sha256, artifacts.c.num_bytes).where(
            artifacts.c.session_id == session_id, artifacts.c.output_key == output_key
        )
        with self._transactions.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else (row.sha256, row.num_bytes)

    def of_stage(self, job_id: str, stage: str) -> list[ChunkOutput]:
        """Outputs of a job's stage, in the order of its chunks."""
        stored = (artifacts.c.session_id == jobs.c.session_id) & (artifacts.c.output_key == chunks.c.output_key)
        query = (
            select(chunks.c.chunk_index, chunks.c.output_key, artifacts.c.sha256)
            .select_from(chunks.join(jobs).outerjoin(artifacts, stored))
            .where(chunks.c.job_id == job_id, chunks.c.stage == stage)
            .order_by(chunks.c.chunk_index)
        )
        with self._transactions.reading() as connection:
            return [ChunkOutput(*row) for row in connection.execute(query)]
