"""Chunks and the workers that hold them: claim, heartbeat, finish, fail, release, give back, reap."""

import contextlib
from collections.abc import Collection, Sequence
from dataclasses import asdict, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, case, delete, func, insert, select, update
from uuid_utils import uuid7

from pipeline.core.findings import Finding
from pipeline.core.options.edits import PersonSpan
from pipeline.core.problems.finding_codes import OUTPUT_DAMAGED, TIME_LIMIT, WORKER_LOST
from pipeline.core.records import from_json
from worker.store.database import transitions
from worker.store.database.access import ServiceRepository
from worker.store.database.connection import now, upsert
from worker.store.database.rows import read, read_edits, read_making, read_spec
from worker.store.database.stored_files import list_results
from worker.store.database.tables import artifacts, chunks, found_people, jobs
from worker.store.database.totals import Total, count
from worker.store.database.transitions import note_failure
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import JobProblem, Result
from worker.store.model.session_records import MadeCalibration
from worker.store.model.states import AT_WORK, ChunkState, JobState
from worker.store.model.work import ANY_CHUNK, Ability, Claim, KeptPiece
from worker.store.repositories.calibrations import complete
from worker.store.repositories.work import next_chunk

# Maximum number of tries of a chunk: lost leases, retryable failures and damaged outputs all count.
MAX_ATTEMPTS = 5
# Maximum number of tries of a chunk that took too long: each has kept a worker for many times its foreseen time.
_MAX_LONG_TRIES = 2


class Leases(ServiceRepository):
    """Leases of chunks, of all tenants.

    A claim has a token. A report with another token, or after the lease was taken back, changes nothing and returns
    ``False``. Times come from the clock of the database.
    """

    def claim(self, worker: str, lease_s: float, ability: Ability = ANY_CHUNK) -> Claim | None:
        """Take the next ready chunk; ``None`` if there is none.

        Tenants have equal shares of the workers, and one worker stays free if there are several tenants. The jobs of a
        tenant are worked on in the order of their creation, but by ``Precedence`` first. Chunks are chosen by
        ``ability``. If the next one does not fit into the memory of the worker's machine beside the running ones, none
        is taken: otherwise small chunks could delay a large one without end. See ``next_chunk``.
        """
        with self._transactions.reading() as connection:
            conditions = next_chunk.ability_conditions(connection, ability)
        with contextlib.suppress(next_chunk.MachineFull):
            while True:
                with self._transactions.reading() as connection:
                    work = next_chunk.next_job(connection, conditions)
                if work is None:
                    return None
                job_id, takes = work
                if (claim := self._claim_chunk(job_id, worker, lease_s, takes, ability.machine_bytes)) is not None:
                    return claim
        return None

    def waits_for_others(self, ability: Ability) -> bool:
        """Return whether a chunk is ready, after a worker found none, and some ready worker has another ability."""
        with self._transactions.reading() as connection:
            return next_chunk.has_others(connection, ability) and next_chunk.next_job(connection) is not None

    def _claim_chunk(
        self, job_id: str, worker: str, lease_s: float, takes: ColumnElement[bool], machine_bytes: int | None
    ) -> Claim | None:
        """Take the next ready chunk of a job, unless another worker took the last one or the tenant's share."""
        with self._transactions.writing() as connection:
            job = transitions.lock_job(connection, job_id)
            if job is None or job.state not in AT_WORK or not next_chunk.has_share(connection, job.tenant):
                return None
            ready = select(chunks).where(chunks.c.job_id == job_id, chunks.c.state == ChunkState.READY, takes)
            ready = ready.order_by(chunks.c.stage_index, chunks.c.chunk_index).limit(1)
            chunk = connection.execute(ready).one_or_none()
            if chunk is None or (chunk.lost_tries and not next_chunk.may_retry(connection, job.tenant)):
                return None
            next_chunk.require_machine(connection, chunk, worker, machine_bytes)
            token = str(uuid7())
            taken = {
                "state": ChunkState.RUNNING,
                "worker": worker,
                "lease_token": token,
                "lease_until": now() + lease_s,
                "started_at": func.coalesce(chunks.c.started_at, now()),
                "claimed_at": now(),
                "moved_at": now(),
            }
            connection.execute(update(chunks).where(chunks.c.id == chunk.id).values(taken))
            transitions.move_job(connection, job_id, JobState.RUNNING, started_at=now())
            next_chunk.take_turn(connection, job.tenant)
        return _claim(job, chunk, token)

    def heartbeat(self, chunk_id: int, lease_token: str, done_units: int, lease_s: float) -> bool:
        """Renew a lease and record the progress of its chunk. ``False``: the work is no longer wanted, stop now.

        The progress is the maximum over all tries of the chunk, and at most ``unit_count``.
        """
        at_work = select(jobs.c.id).where(jobs.c.id == chunks.c.job_id, jobs.c.state == JobState.RUNNING).exists()
        further = case((chunks.c.unit_count < done_units, chunks.c.unit_count), else_=done_units)
        moved = case((chunks.c.done_units < further, now()), else_=chunks.c.moved_at)
        with self._transactions.writing() as connection:
            renewed = connection.execute(
                update(chunks)
                .where(chunks.c.id == chunk_id, _is_held(lease_token), at_work)
                .values(
                    done_units=case((chunks.c.done_units < further, further), else_=chunks.c.done_units),
                    moved_at=moved,
                    lease_until=now() + lease_s,
                )
            )
        return renewed.rowcount == 1

    def holds(self, chunk_id: int, lease_token: str) -> bool:
        """True if a token still holds its chunk, such as one of a job that is being canceled."""
        with self._transactions.reading() as connection:
            return (
                connection.scalar(select(chunks.c.id).where(chunks.c.id == chunk_id, _is_held(lease_token))) is not None
            )

    def finish(
        self,
        chunk_id: int,
        lease_token: str,
        sha256: str,
        num_bytes: int,
        reused: bool = False,
        results: Sequence[Result] = (),
        warnings: Sequence[Finding] = (),
        calibration: MadeCalibration | None = None,
        people: Sequence[PersonSpan] | None = None,
        pieces: Sequence[KeptPiece] = (),
    ) -> bool:
        """Record the output of a chunk with its pieces, and its results: files, warnings, people, ...

        Returns whether the next stage became ready.
        """
        with self._transactions.writing() as connection:
            held = _lock_held(connection, chunk_id, lease_token)
            if held is None:
                return False
            job, chunk = held
            for stored in (KeptPiece(chunk.output_key, sha256, num_bytes), *pieces):
                row = {"output_key": stored.key, "sha256": stored.sha256, "num_bytes": stored.num_bytes}
                upsert(connection, artifacts, {"session_id": job.session_id, **row})
            list_results(connection, job.reconstruction_id or job.id, results)
            if people is not None:
                connection.execute(delete(found_people).where(found_people.c.job_id == job.id))
            if people:
                connection.execute(insert(found_people), [{"job_id": job.id, **asdict(person)} for person in people])
            # Results of a new revision replace the warnings of the last one, also by none.
            if warnings or people is not None:
                documents = [asdict(warning) for warning in warnings]
                connection.execute(update(jobs).where(jobs.c.id == job.id).values(warnings=documents))
            if calibration is not None:
                complete(connection, job.id, calibration)
            done = {"done_units": chunk.unit_count, "reused": reused, "lost_tries": 0}
            transitions.move_chunk(connection, chunk_id, ChunkState.DONE, **done)
            _count_done(connection, chunk, reused)
            transitions.set_waiting(connection, job, None)
            if job.state == JobState.CANCELING:
                transitions.settle_canceling(connection, job.id)
                return False
            return transitions.advance(connection, job.id, chunk.stage_index)

    def fail(self, chunk_id: int, lease_token: str, problem: JobProblem) -> bool:
        """Record a failed try, which the chunk repeats or which ends the job; return whether the chunk became ready."""
        with self._transactions.writing() as connection:
            held = _lock_held(connection, chunk_id, lease_token)
            return held is not None and _try_again(connection, *held, problem)

    def release(self, chunk_id: int, lease_token: str, outage: JobProblem | None = None) -> bool:
        """Give a chunk back unfinished; it costs no try. Return whether it became ready.

        Its job is canceled, or its worker stops, or there is an ``outage``, for which the job waits.
        """
        with self._transactions.writing() as connection:
            held = _lock_held(connection, chunk_id, lease_token)
            if held is None:
                return False
            job, chunk = held
            if job.state == JobState.CANCELING:
                _cancel(connection, job, chunk)
                return False
            transitions.move_chunk(connection, chunk.id, ChunkState.READY)
            if outage is not None:
                count(connection, Total.CHUNKS_GIVEN_BACK, chunk.stage)
                transitions.set_waiting(connection, job, outage)
            return True

    def compute_again(self, chunk_id: int, lease_token: str, stage: str, damaged: Collection[int]) -> bool:
        """Give a chunk back until chunks of an earlier stage, whose outputs are damaged, have run again.

        A chunk of the earlier stage that has had ``MAX_ATTEMPTS`` tries ends the job. ``damaged`` are the indices of
        the chunks of the earlier ``stage``. Returns whether a chunk became ready.
        """
        with self._transactions.writing() as connection:
            held = _lock_held(connection, chunk_id, lease_token)
            if held is None:
                return False
            job, waiting = held
            if job.state == JobState.CANCELING:
                _cancel(connection, job, waiting)
                return False
            transitions.move_chunk(connection, waiting.id, ChunkState.WAITING)
            # Other chunks may have reported the same: a chunk that is not done is being computed already.
            done = select(chunks).where(
                chunks.c.job_id == job.id, chunks.c.stage == stage, chunks.c.state == ChunkState.DONE
            )
            again = [chunk for chunk in connection.execute(done).all() if chunk.chunk_index in damaged]
            # The first chunk without another try ends the job.
            return bool(again) and all(
                _try_again(connection, job, chunk, _output_damaged(chunk), started_at=None, finished_at=None)
                for chunk in again
            )

    def reap(self, lease_s: float, takes: bool = True) -> bool:
        """Take chunks back whose leases have ended; return whether any chunk is ready now.

        A chunk that is taken back is ready for another try, which may have to wait, see ``next_chunk``; after
        ``MAX_ATTEMPTS`` tries its job fails. A job that is being canceled ends when its last running chunk is taken
        back. Leases longer than ``lease_s`` are shortened: they were made before the clock was put back. Unless
        ``takes``, chunks are not taken back: their workers may still renew the leases.
        """
        with self._transactions.writing() as connection:
            connection.execute(
                update(chunks)
                .where(chunks.c.state == ChunkState.RUNNING, chunks.c.lease_until > now() + lease_s)
                .values(lease_until=now() + lease_s)
            )
        expired = select(chunks.c.id, chunks.c.lease_token).where(
            chunks.c.state == ChunkState.RUNNING, chunks.c.lease_until < now()
        )
        with self._transactions.reading() as connection:
            found = connection.execute(expired).all() if takes else []
        for chunk_id, lease_token in found:
            with self._transactions.writing() as connection:
                held = _lock_held(connection, chunk_id, lease_token, expired=True)
                if held is not None:
                    count(connection, Total.LEASES_LOST, held[1].stage)
                    _try_again(connection, *held, _worker_lost(held[1].stage))
        with self._transactions.reading() as connection:
            return next_chunk.next_job(connection) is not None


def _claim(job: Row[Any], chunk: Row[Any], token: str) -> Claim:
    return read(
        Claim,
        chunk,
        chunk_id=chunk.id,
        index=chunk.chunk_index,
        lease_token=token,
        session_id=job.session_id,
        spec=read_spec(job.spec),
        job_attempt=job.attempt,
        trace=job.trace,
        making=read_making(job.kind, job.making),
        edits=read_edits(job.edits),
        revision=job.revision,
        reconstruction_id=job.reconstruction_id,
        provider=job.provider,
        character=from_json(JobCharacter, job.character),
    )


def _is_held(lease_token: str) -> ColumnElement[bool]:
    return and_(chunks.c.lease_token == lease_token, chunks.c.state == ChunkState.RUNNING)


def _lock_held(
    connection: Connection, chunk_id: int, lease_token: str, expired: bool = False
) -> tuple[Row[Any], Row[Any]] | None:
    """Lock the job of a chunk that a token holds, and return both; ``None`` if it is not held (or not expired)."""
    held = select(chunks).where(chunks.c.id == chunk_id, _is_held(lease_token))
    if expired:
        held = held.where(chunks.c.lease_until < now())
    seen = connection.execute(held).one_or_none()
    if seen is None:
        return None
    reconstruction = connection.scalar(select(jobs.c.reconstruction_id).where(jobs.c.id == seen.job_id))
    if reconstruction is not None:
        transitions.lock_job(
            connection, reconstruction
        )  # whose visuals the job makes: an edit locks it, and deletes this job
    job = transitions.lock_job(connection, seen.job_id)
    # Again: the chunk may have been taken back before the job was locked. From here on a heartbeat waits.
    chunk = connection.execute(held.with_for_update()).one_or_none()
    return None if job is None or chunk is None else (job, chunk)


def _try_again(connection: Connection, job: Row[Any], chunk: Row[Any], problem: JobProblem, **values: Any) -> bool:
    """Make a chunk ready for its next try, or end its job; return whether it became ready. ``values`` are columns."""
    if job.state == JobState.CANCELING:
        _cancel(connection, job, chunk)
        return False
    note_failure(connection, job, chunk, problem)
    max_tries = _MAX_LONG_TRIES if problem.code == TIME_LIMIT else MAX_ATTEMPTS
    if problem.retryable and chunk.attempt < max_tries:
        if problem.code in {WORKER_LOST, TIME_LIMIT}:
            values |= next_chunk.lost_try_columns(chunk.lost_tries)
        transitions.move_chunk(connection, chunk.id, ChunkState.READY, attempt=chunk.attempt + 1, **values)
        count(connection, Total.CHUNKS_RETRIED, chunk.stage)
        return True
    if problem.retryable:
        problem = replace(problem, detail=f"{problem.detail} It was the last of {max_tries} tries.")
    transitions.fail_job(connection, job.id, chunk.id, problem)
    return False


def _cancel(connection: Connection, job: Row[Any], chunk: Row[Any]) -> None:
    transitions.move_chunk(connection, chunk.id, ChunkState.CANCELED)
    transitions.settle_canceling(connection, job.id)


def _count_done(connection: Connection, chunk: Row[Any], reused: bool) -> None:
    if reused:
        count(connection, Total.CHUNKS_REUSED, chunk.stage)
        return
    seconds = connection.scalar(select(now() - chunks.c.started_at).where(chunks.c.id == chunk.id)) or 0.0
    count(connection, Total.CHUNKS_DONE, chunk.stage)
    count(connection, Total.CHUNK_SECONDS, chunk.stage, max(0.0, seconds))
    count(connection, Total.CHUNK_UNITS, chunk.stage, chunk.unit_count)


def _worker_lost(stage: str) -> JobProblem:
    return JobProblem(
        WORKER_LOST,
        f"A worker of the stage {stage} fell silent.",
        stage=stage,
        hint="It may lack memory. Retry the job; if it fails again, the workers' logs and the system's say more.",
        retryable=True,
    )


def _output_damaged(chunk: Row[Any]) -> JobProblem:
    return JobProblem(
        OUTPUT_DAMAGED,
        f"The stored output of chunk {chunk.chunk_index} of the stage {chunk.stage} was damaged.",
        stage=chunk.stage,
        hint="Check the disk that holds the service's artifacts, then retry the job: whole outputs are used again.",
        retryable=True,
    )
