"""Plans of jobs and outputs of their chunks.

Rows of chunks are added with a job, and replaced if no worker runs the code that they were made for. Outputs stay with
the session, so that its other jobs can reuse them.
"""

from collections.abc import Iterable, Sequence
from itertools import islice, takewhile

from sqlalchemy import Connection, delete, insert, literal, select, true, update

from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.plan import STAGE_BY_NAME, interim_readers
from worker.store.database.access import ServiceRepository
from worker.store.database.tables import artifacts, chunks, jobs, sessions
from worker.store.database.transitions import lock_job
from worker.store.errors import VideosDeleted
from worker.store.model.states import AT_WORK, ChunkState
from worker.store.model.work import ChunkOutput, StagePlan
from worker.store.repositories.work.workers import codes_at_work

_ROWS_AT_ONCE = 1000


class Plans(ServiceRepository):
    """Plans of unfinished jobs that were made by another version of the code."""

    def unclaimable(self) -> list[str]:
        """Ids of unfinished jobs without running chunks whose ready chunks no worker can run."""
        with self._transactions.reading() as connection:
            foreign = chunks.c.code.not_in(codes_at_work(connection))
            in_job = chunks.c.job_id == jobs.c.id
            is_waiting = select(chunks.c.id).where(in_job, chunks.c.state == ChunkState.READY, foreign).exists()
            is_running = select(chunks.c.id).where(in_job, chunks.c.state == ChunkState.RUNNING).exists()
            query = select(jobs.c.id).where(jobs.c.state.in_(AT_WORK), is_waiting, ~is_running)
            return list(connection.scalars(query.order_by(jobs.c.queued_at, jobs.c.id)))

    def is_run(self, codes: Iterable[str]) -> bool:
        """Return whether ready workers run all of some code, so that they could run a plan that is made for it."""
        with self._transactions.reading() as connection:
            return codes_at_work(connection).issuperset(codes)

    def replace(self, job_id: str, stages: Sequence[StagePlan]) -> bool:
        """Replace the plan of an unfinished job without running chunks; outputs of equal keys are used again.

        Returns whether it was replaced.
        """
        with self._transactions.writing() as connection:
            job = lock_job(connection, job_id)
            running = select(chunks.c.id).where(chunks.c.job_id == job_id, chunks.c.state == ChunkState.RUNNING)
            if job is None or job.state not in AT_WORK or connection.execute(running.limit(1)).first() is not None:
                return False
            connection.execute(delete(chunks).where(chunks.c.job_id == job_id))
            insert_chunks(connection, job_id, stages)
            return True


def require_videos(
    connection: Connection, session_id: str, stages: Sequence[StagePlan], config: ReconstructionConfig
) -> None:
    """Raise ``VideosDeleted`` if a plan needs the videos of a session, and they were deleted.

    The session can't lose its videos until the transaction ends. A plan does without them if all outputs of stages that
    read them are stored, and the interim outputs of these stages are not asked for.
    """
    query = select(sessions.c.videos_deleted_at).where(sessions.c.id == session_id)
    if connection.scalar(query.with_for_update(read=True, key_share=True)) is None:
        return
    is_missing = {stage.name: _is_missing(connection, session_id, stage) for stage in stages}
    for stage in (STAGE_BY_NAME[name] for name in is_missing):
        interim_for = interim_readers(stage.name) if stage.leaves_interim(config) else ()
        if stage.reads_videos and any(is_missing.get(name, False) for name in (stage.name, *interim_for)):
            raise VideosDeleted


def _is_missing(connection: Connection, session_id: str, stage: StagePlan) -> bool:
    if not STAGE_BY_NAME[stage.name].is_reusable:
        return True
    keys = {chunk.output_key for chunk in stage.chunks}
    stored = connection.scalars(select(artifacts.c.output_key).where(artifacts.c.session_id == session_id))
    return not keys.issubset(stored)


def insert_chunks(connection: Connection, job_id: str, stages: Sequence[StagePlan], num_done: int = 0) -> None:
    """Insert the chunks of all stages, some at a time: a long session has too many for the memory.

    The first ``num_done`` stages are done, and have their chunks already.
    """
    if not stages or any(next(iter(stage.chunks), None) is None for stage in stages):
        raise ValueError("a job needs a stage, and every stage a chunk")
    provider = max(stage.provider for stage in stages)  # they have the same, or none
    connection.execute(update(jobs).where(jobs.c.id == job_id).values(provider=provider))
    rows = (
        {
            "job_id": job_id,
            "stage_index": stage_index,
            "stage": stage.name,
            "code": stage.code_sha256,
            "chunk_index": chunk.index,
            "payload": dict(chunk.payload),
            "output_key": chunk.output_key,
            "unit_count": chunk.unit_count,
            "memory_bytes": chunk.memory_bytes,
            "state": ChunkState.READY if (stage_index == num_done) else ChunkState.WAITING,
        }
        for stage_index, stage in enumerate(stages)
        if stage_index >= num_done
        for chunk in stage.chunks
    )
    while some := list(islice(rows, _ROWS_AT_ONCE)):
        connection.execute(insert(chunks), some)


def plan_changes(connection: Connection, job_id: str, stages: Sequence[StagePlan]) -> None:
    """Plan a finished job again; the first stages stay done whose chunks are done under the same keys."""
    num_kept = _count_done(connection, job_id, stages)
    connection.execute(delete(chunks).where(chunks.c.job_id == job_id, chunks.c.stage_index >= num_kept))
    insert_chunks(connection, job_id, stages, num_kept)


def insert_following(connection: Connection, job_id: str, stages: Sequence[StagePlan], earlier_id: str) -> None:
    """Insert the chunks of a job that continues another one; finished stages of the other job are done."""
    num_done = _count_done(connection, earlier_id, stages)
    copied = "stage_index", "stage", "code", "chunk_index", "payload", "output_key", "unit_count", "done_units", "state"
    times = "started_at", "finished_at"
    rows = select(literal(job_id), literal(1), true(), *(chunks.c[name] for name in (*copied, *times))).where(
        chunks.c.job_id == earlier_id, chunks.c.stage_index < num_done
    )
    columns = ["job_id", "attempt", "reused", *copied, *times]
    connection.execute(insert(chunks).from_select(columns, rows, include_defaults=False))
    insert_chunks(connection, job_id, stages, num_done)


def _count_done(connection: Connection, job_id: str, stages: Sequence[StagePlan]) -> int:
    """Count the first stages whose chunks a job has done under the same keys."""
    done = (_is_done(connection, job_id, number, stage) for number, stage in enumerate(stages))
    return sum(1 for _ in takewhile(bool, done))


def _is_done(connection: Connection, job_id: str, stage_index: int, stage: StagePlan) -> bool:
    """True if all chunks of a stage are done, under the keys of a plan, and may stay."""
    query = select(chunks.c.stage, chunks.c.state, chunks.c.output_key).where(
        chunks.c.job_id == job_id, chunks.c.stage_index == stage_index
    )
    rows = connection.execute(query.order_by(chunks.c.chunk_index)).all()
    if not STAGE_BY_NAME[stage.name].is_reusable:
        return False
    return [(stage.name, ChunkState.DONE, chunk.output_key) for chunk in stage.chunks] == [tuple(row) for row in rows]


class Outputs(ServiceRepository):
    """Outputs of all sessions."""

    def find(self, session_id: str, output_key: str) -> tuple[str, int] | None:
        """SHA-256 and size in bytes of a chunk's output if any job of the session has finished the chunk."""
        query = select(artifacts.c.sha256, artifacts.c.num_bytes).where(
            artifacts.c.session_id == session_id, artifacts.c.output_key == output_key
        )
        with self._transactions.reading() as connection:
            row = connection.execute(query).one_or_none()
        return None if row is None else (row.sha256, row.num_bytes)

    def list_stage(self, job_id: str, stage: str) -> list[ChunkOutput]:
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
