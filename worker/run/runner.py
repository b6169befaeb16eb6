"""Claim chunks, run them, record what came of it: the one loop of every worker."""

import hashlib
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import structlog
from opentelemetry import trace
from opentelemetry.trace import StatusCode

from pipeline.core.runtime.pauses import Pauses
from pipeline.run.engine.plan import STAGE_BY_NAME, interim_readers
from pipeline.run.engine.stage import Output, ResultFile
from worker.run import tracing
from worker.run.chunk import DamagedOutputsError, Lease, StoppedError, Work, time_limit_s
from worker.run.presence import process_name, scratch_folder
from worker.run.problems import job_problem, too_long, waiting_for
from worker.store.errors import ArtifactsUnavailable, DamagedArtifact, DamagedDatabase, NotFound, UnknownSchema
from worker.store.files.artifacts import (
    ArtifactStore,
    copy_artifact,
    copy_interim,
    read_artifact,
    read_interim,
    write_interim,
)
from worker.store.files.file_keys import first_people_key, result_key, stage_key
from worker.store.model.job_records import Result
from worker.store.model.session_records import MadeCalibration
from worker.store.model.work import Ability, Claim, KeptPiece
from worker.store.outages import Outage, find_outage
from worker.store.store import JobStore

log = structlog.get_logger()

# Pauses during an outage: before the next chunk, and before the next report of a chunk, which is lost with its lease.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S, _LONGEST_REPORT_PAUSE_S = 0.5, 30.0, 5.0
# Time between two looks whether the worker shuts down.
_LOOK_S = 0.1


class Runner:
    """Works on whatever is ready.

    A chunk that meets an outage of the artifact store or the database is given back, and costs no try. The runner then
    waits, with growing pauses, until the part responds.

    - ``store``, ``artifacts``: where the work is and where it goes.
    - ``publish``: wakes a worker.
    - ``run``: runs a chunk.
    - ``lease_s``, ``heartbeat_s``: see ``WorkerSettings``.
    - ``stopping``: says whether the worker shuts down: the chunk at hand is given back, and no more is claimed.
    - ``on_stuck``: see ``Lease``; called after the chunk was released.
    - ``has_room``: says whether there is room on the disk for a chunk's output; without it none is claimed, and jobs
      wait.
    - ``ability``: what the worker can run.
    - ``pass_on``: wakes a worker with another ability.
    - ``chunk_time_factor``: see ``WorkerSettings``.
    """

    def __init__(
        self,
        store: JobStore,
        artifacts: ArtifactStore,
        publish: Callable[[], object],
        run: Callable[[Work], Output],
        lease_s: float,
        heartbeat_s: float,
        stopping: Callable[[], bool],
        on_stuck: Callable[[], None],
        has_room: Callable[[], bool],
        ability: Ability,
        pass_on: Callable[[], object],
        chunk_time_factor: float = 10.0,
    ) -> None:
        self._store, self._artifacts, self._publish, self._run_chunk = store, artifacts, publish, run
        self._lease_s, self._heartbeat_s, self._chunk_time_factor = lease_s, heartbeat_s, chunk_time_factor
        self._stopping, self._on_stuck, self._has_room = stopping, on_stuck, has_room
        self._name = process_name()
        self._ability, self._pass_on = ability, pass_on
        self._pauses = Pauses(_FIRST_PAUSE_S, _LONGEST_PAUSE_S)
        self._outage: Outage | None = None

    def work(self, claim_for_s: float, is_for_all: bool = True) -> int:
        """Run ready chunks until there are none, or for about ``claim_for_s`` seconds; returns how many were run.

        One message may stand for many chunks: a worker that finds work wakes the next one before it begins. A worker
        that finds none that it can run passes a message on that ``is_for_all`` workers.
        """
        deadline_s = time.monotonic() + claim_for_s
        num_run = 0
        while not self._stopping():
            if time.monotonic() > deadline_s:
                self._publish()
                break
            if self._outage is not None:
                self._pause(self._pauses, self._outage)
            try:
                claim = self._next_claim(is_first=num_run == 0)
            except Exception as error:
                self._outage = find_outage(error)
                if self._outage is None:
                    raise
                continue
            if claim is None:
                if num_run == 0 and is_for_all:
                    self._leave_to_others()
                break
            if num_run == 0:
                self._publish()
            self._run(claim)
            num_run += 1
        return num_run

    def _next_claim(self, is_first: bool) -> Claim | None:
        """Claim a chunk; ``None`` if this worker can do nothing now."""
        if is_first and not self._knows_schema():
            return None
        if not self._has_room():
            log.warning("disk_full")  # the reaper wakes a worker as long as there is work
            return None
        if self._outage is Outage.ARTIFACTS and not self._artifacts.ping():
            raise ArtifactsUnavailable
        return self._store.leases.claim(self._name, self._lease_s, self._ability)

    def _leave_to_others(self) -> None:
        """Wake a worker with another ability if it could do what this one can't."""
        try:
            if self._store.leases.waits_for_others(self._ability):
                self._pass_on()
        except Exception as error:
            if find_outage(error) is None:
                raise  # else the reaper wakes a worker later

    def _pause(self, pauses: Pauses, outage: Outage) -> None:
        """Wait during an outage, or until the worker shuts down."""
        pause_s = pauses.next_s()
        log.warning("waiting", outage=outage, seconds=round(pause_s, 1))
        end_s = time.monotonic() + pause_s
        while not self._stopping() and (left_s := end_s - time.monotonic()) > 0.0:
            time.sleep(min(_LOOK_S, left_s))

    def _knows_schema(self) -> bool:
        """True if no newer version has upgraded the database while this one ran: its work is not ours."""
        try:
            self._store.require_known_schema()
        except UnknownSchema as error:
            log.error("newer_database", detail=str(error))  # noqa: TRY400 - there is no mistake to trace
            return False
        return True

    def _run(self, claim: Claim) -> None:
        with (
            structlog.contextvars.bound_contextvars(job=claim.job_id, stage=claim.stage, chunk=claim.index),
            tracing.chunk_span(claim) as span,
        ):
            lease = self._lease(claim)
            try:
                with lease.held():
                    record = self._finish(claim, lease)
                self._outage = None
                self._pauses.reset()
            except StoppedError:
                log.info("chunk_stopped")
                span.set_attribute("multicap.stopped", True)
                record = self._stopped(claim, lease)
            except DamagedOutputsError as error:
                log.warning("outputs_damaged", stage=error.stage, chunks=sorted(error.chunks))
                record = partial(self._store.leases.compute_again, *_held(claim), error.stage, error.chunks)
            except DamagedDatabase:
                raise
            except Exception as error:
                span.record_exception(error)
                span.set_status(StatusCode.ERROR)
                record = self._failure(claim, error)
            if self._report(claim, lease, record):
                self._publish()

    def _stopped(self, claim: Claim, lease: Lease) -> Callable[[], bool]:
        """Report of a chunk that was stopped before its end."""
        if lease.is_too_long:
            return partial(self._store.leases.fail, *_held(claim), too_long(claim.stage))
        return partial(self._store.leases.release, *_held(claim))

    def _failure(self, claim: Claim, error: Exception) -> Callable[[], bool]:
        """Report of a chunk that failed, or that met an outage."""
        self._outage = find_outage(error)
        if self._outage is None:
            log.error("chunk_failed", attempt=claim.attempt, exc_info=error)
            return partial(self._store.leases.fail, *_held(claim), job_problem(error, claim.stage))
        log.warning("chunk_given_back", outage=self._outage, exc_info=error)
        return partial(self._store.leases.release, *_held(claim), waiting_for(self._outage, claim.stage))

    def _report(self, claim: Claim, lease: Lease, record: Callable[[], bool]) -> bool:
        """Record what came of a chunk, as soon as the database responds; return whether more work became ready.

        A chunk that was taken back because its worker was cut off, but not lost, gets its try back.
        """
        pauses = Pauses(_FIRST_PAUSE_S, _LONGEST_REPORT_PAUSE_S)
        was_cut_off = lease.was_cut_off
        while True:
            try:
                more = record()
                if was_cut_off:
                    self._store.waits.excuse(claim)
            except Exception as error:
                if find_outage(error) is not Outage.DATABASE:
                    raise
                was_cut_off = True
                if self._stopping():
                    return False  # the lease runs out
                self._pause(pauses, Outage.DATABASE)
            else:
                return more

    def _lease(self, claim: Claim) -> Lease:
        def on_stuck() -> None:
            log.warning("chunk_stuck", job=claim.job_id, stage=claim.stage, chunk=claim.index)
            try:
                self._stopped(claim, lease)()
            finally:
                self._on_stuck()

        limit_s = time_limit_s(claim.unit_count, self._chunk_time_factor)
        lease = Lease(self._store, claim, self._lease_s, self._heartbeat_s, self._stopping, on_stuck, limit_s)
        return lease

    def _finish(self, claim: Claim, lease: Lease) -> Callable[[], bool]:
        """Run a chunk, or find its output; return the report of it, which says whether more work became ready."""
        found = self._reusable(claim)
        if found is not None and not self._lacks_interim(claim):
            log.info("chunk_reused")
            trace.get_current_span().set_attribute("multicap.reused", True)
            return partial(self._store.leases.finish, *_held(claim), *found, reused=True)
        stored = None if found is None else self._stored(claim, found[0])
        started_s = time.monotonic()
        with scratch_folder() as scratch:
            output = self._run_chunk(
                Work(
                    claim=claim,
                    session=self._store.sessions.get(claim.session_id),
                    artifacts=self._artifacts,
                    outputs=partial(self._outputs, claim),
                    scratch=scratch,
                    on_unit=lease.on_unit,
                    check=lease.check,
                    interim=partial(self._interim, claim),
                    copy_output=partial(self._copy_output, claim),
                    found=stored,
                    finished=partial(self._finished, claim),
                    piece=partial(self._piece, claim),
                )
            )
            lease.check()
            results = [self._keep(claim, file) for file in output.files]
            pieces = [self._keep_piece(claim, key, path) for key, path in output.pieces.items()]
            if output.interim is not None:
                write_interim(self._artifacts, claim, output.interim)
            if output.first_people is not None:
                key = first_people_key(claim.job_id, claim.job_attempt, claim.output_key)
                self._artifacts.put_bytes(key, output.first_people)
            digest, num_bytes = _measured(output.content)
            if stored is None:
                self._put(stage_key(claim.session_id, claim.output_key), output.content)
        log.info("chunk_done", seconds=round(time.monotonic() - started_s, 3))
        return partial(
            self._store.leases.finish,
            *_held(claim),
            digest,
            num_bytes,
            results=results,
            warnings=output.warnings,
            calibration=None if output.calibration is None else MadeCalibration(**output.calibration),
            people=output.people,
            pieces=pieces,
        )

    def _put(self, key: str, content: bytes | Path) -> None:
        if isinstance(content, Path):
            self._artifacts.put_file(key, content)
        else:
            self._artifacts.put_bytes(key, content)

    def _reusable(self, claim: Claim) -> tuple[str, int] | None:
        """Digest and size of this chunk's output if it was finished before and is still whole."""
        if not STAGE_BY_NAME[claim.stage].is_reusable:
            return None
        recorded = self._store.outputs.find(claim.session_id, claim.output_key)
        if recorded is None or not self._is_whole(claim.session_id, claim.output_key, recorded[0]):
            return None
        return recorded

    def _is_whole(self, session_id: str, output_key: str, sha256: str | None) -> bool:
        # Without a digest it is being computed.
        return self._is_stored(stage_key(session_id, output_key), sha256 or "")

    def _is_stored(self, key: str, sha256: str) -> bool:
        """True if an artifact is there and undamaged."""
        try:
            self._artifacts.open(key, sha256).close()
        except (NotFound, DamagedArtifact):
            return False
        return True

    def _lacks_interim(self, claim: Claim) -> bool:
        """True if this chunk's interim output is missing, and a stage that reads it has yet to run."""
        if not STAGE_BY_NAME[claim.stage].leaves_interim(claim.config):
            return False
        if read_interim(self._artifacts, claim, claim.output_key) is not None:
            return False
        return any(
            not STAGE_BY_NAME[stage].is_reusable or not self._is_whole(claim.session_id, output.key, output.sha256)
            for stage in interim_readers(claim.stage)
            for output in self._store.outputs.list_stage(claim.job_id, stage)
        )

    def _stored(self, claim: Claim, sha256: str, output_key: str | None = None) -> bytes | None:
        """Output of this chunk that an earlier job has left, or another output."""
        try:
            return read_artifact(self._artifacts, stage_key(claim.session_id, output_key or claim.output_key), sha256)
        except (NotFound, DamagedArtifact):
            return None

    def _finished(self, claim: Claim, stage: str, chunks: slice) -> list[bytes | None]:
        """Outputs of a stage's chunks, ``None`` of the chunks that are not done."""
        outputs = self._store.outputs.list_stage(claim.job_id, stage)[chunks]
        return [None if one.sha256 is None else self._stored(claim, one.sha256, one.key) for one in outputs]

    def _piece(self, claim: Claim, key: str) -> bytes | None:
        """Piece that an earlier chunk has kept; ``None`` if it is missing or damaged."""
        recorded = self._store.outputs.find(claim.session_id, key)
        return None if recorded is None else self._stored(claim, recorded[0], key)

    def _keep_piece(self, claim: Claim, key: str, path: Path) -> KeptPiece:
        piece = KeptPiece(key, *_measured(path))
        self._artifacts.put_file(stage_key(claim.session_id, key), path)
        return piece

    def _outputs(self, claim: Claim, stage: str, chunks: slice = slice(None)) -> list[bytes]:
        contents, damaged = [], set()
        for output in self._store.outputs.list_stage(claim.job_id, stage)[chunks]:
            key = stage_key(claim.session_id, output.key)
            try:
                # Without a digest it is being computed again.
                contents.append(read_artifact(self._artifacts, key, output.sha256 or ""))
            except (NotFound, DamagedArtifact):
                damaged.add(output.index)
        if damaged:
            raise DamagedOutputsError(stage, damaged)
        return contents

    def _copy_output(self, claim: Claim, stage: str, chunk: int, path: Path, is_interim: bool) -> None:
        """Copy the output, or the interim output, of an earlier stage's chunk to a file."""
        output = self._store.outputs.list_stage(claim.job_id, stage)[chunk]
        try:
            if is_interim:
                copy_interim(self._artifacts, claim, output.key, path)
            else:
                # Without a digest it is being computed again.
                copy_artifact(self._artifacts, stage_key(claim.session_id, output.key), output.sha256 or "", path)
        except (NotFound, DamagedArtifact) as error:
            raise DamagedOutputsError(stage, {output.index}) from error

    def _interim(self, claim: Claim, stage: str, chunks: slice = slice(None)) -> list[bytes]:
        outputs = self._store.outputs.list_stage(claim.job_id, stage)[chunks]
        contents = [read_interim(self._artifacts, claim, output.key) for output in outputs]
        if damaged := {output.index for output, content in zip(outputs, contents, strict=True) if content is None}:
            raise DamagedOutputsError(stage, damaged)
        return [content for content in contents if content is not None]

    def _keep(self, claim: Claim, file: ResultFile) -> Result:
        """Store a result file, unless the revision before has stored the same bytes."""
        sha256, num_bytes = _measured(file.path)
        listed = self._store.results.listed(claim.listed_by, file.name)
        if listed is not None and listed.sha256 == sha256 and self._is_stored(listed.key, sha256):
            key = listed.key
        else:
            key = result_key(claim.listed_by, file.name, claim.revision, file.kind)
            self._artifacts.put_file(key, file.path)
        return Result(
            name=file.name,
            kind=file.kind,
            person=file.person,
            media_type=file.media_type,
            key=key,
            num_bytes=num_bytes,
            sha256=sha256,
            revision=claim.revision,
            person_name=file.person_name,
        )


def _held(claim: Claim) -> tuple[int, str]:
    return claim.chunk_id, claim.lease_token


def _measured(content: bytes | Path) -> tuple[str, int]:
    """Digest and size of bytes, or of a file."""
    if isinstance(content, bytes):
        return hashlib.sha256(content).hexdigest(), len(content)
    with content.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest(), content.stat().st_size
