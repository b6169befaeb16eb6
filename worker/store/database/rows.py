"""Records of the model, made from rows of the tables."""

import functools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import datetime, timedelta
from itertools import compress, groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, case, func, select, true, tuple_

from pipeline.capture.preflight_record import Preflight
from pipeline.core.findings import Finding
from pipeline.core.options.config import ReconstructionConfig, method_warnings
from pipeline.core.options.edits import PeopleEdit, read_edit
from pipeline.core.options.job_choices import BLURRED_KIND, CalibrationChoices, ProxyChoices, VisualChoices
from pipeline.core.records import from_json
from pipeline.run.engine.stage import DETECT
from pipeline.run.space import foreseen_space, unit_s
from worker.store.database.connection import now
from worker.store.database.tables import chunks, edits, jobs, results, sessions
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import JobRecord, Making, NewestJob, StageProgress, job_config
from worker.store.model.session_records import Session
from worker.store.model.states import ChunkState, JobState
from worker.store.spec import JobSpec

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

RecordT = TypeVar("RecordT", bound="DataclassInstance")

_STATES = tuple(ChunkState)
_ENDED = frozenset({ChunkState.DONE, ChunkState.FAILED, ChunkState.CANCELED})


def read(record: type[RecordT], row: Row[Any], **converted: Any) -> RecordT:
    """Record from the columns of a row that are named as its fields; ``converted`` are values of other fields."""
    kinds = _kinds(record)
    names = kinds.keys() & row._mapping.keys() - converted.keys()
    return record(**{name: from_json(kinds[name], row._mapping[name]) for name in names}, **converted)


@functools.cache
def _kinds(record: type["DataclassInstance"]) -> Mapping[str, Any]:
    hints = get_type_hints(record)
    return {field.name: hints[field.name] for field in fields(record)}


def read_session(row: Row[Any]) -> Session:
    """Session from its row."""
    return read(Session, row, metadata=row.client_metadata, errors=tuple(row.errors or ()))


# Clients ask for jobs all the time, and building the query takes longer than running it.
@functools.cache
def select_jobs() -> Select[Any]:
    """Query of jobs with the preflight of their sessions, for ``read_jobs``."""
    elapsed_s = now() - jobs.c.started_at
    return select(
        jobs,
        sessions.c.name.label("session_name"),
        sessions.c.preflight,
        sessions.c.videos_deleted_at,
        edits.c.revision.label("session_edits_revision"),
        elapsed_s.label("elapsed_s"),
    ).select_from(jobs.join(sessions).outerjoin(edits, edits.c.session_id == sessions.c.id))


def read_jobs(connection: Connection, rows: Sequence[Row[Any]]) -> list[JobRecord]:
    """Jobs with their stages and their places in the queue, from rows of ``select_jobs``."""
    stages = _stages(connection, [row.id for row in rows])
    visuals = _visuals_jobs(connection, [row.id for row in rows if row.revision > 0])
    blurred = _num_blurred(connection, [row.id for row in rows if row.spec["blur_faces"]])
    positions = _queue_positions(connection, [row for row in rows if row.state == JobState.QUEUED])
    return [
        _job(row, stages.get(row.id, ()), visuals.get(row.id), blurred.get(row.id, 0), positions.get(row.id))
        for row in rows
    ]


def _queue_positions(connection: Connection, queued: Sequence[Row[Any]]) -> Mapping[str, int]:
    """Places in the queue of queued jobs, from 1, by id; the queue is read once, up to the last of them."""
    if not queued:
        return {}
    last = max(queued, key=lambda row: (row.precedence, row.queued_at, row.id))
    rows = connection.execute(_select_positions(), {"job_ids": [row.id for row in queued], "last_id": last.id})
    return {row.id: row.position for row in rows}


@functools.cache
def _select_positions() -> Select[Any]:
    last = jobs.alias("last")
    order, of_last = ((table.c.precedence, table.c.queued_at, table.c.id) for table in (jobs, last))
    queue = (
        select(jobs.c.id, func.row_number().over(order_by=order).label("position"))
        .join(last, last.c.id == bindparam("last_id"))
        .where(jobs.c.state == JobState.QUEUED, tuple_(*order) <= tuple_(*of_last))
        .subquery()
    )
    return select(queue.c.id, queue.c.position).where(queue.c.id.in_(bindparam("job_ids", expanding=True)))


def _visuals_jobs(connection: Connection, job_ids: Sequence[str]) -> Mapping[str, NewestJob]:
    """Jobs that make visuals of edited jobs, by the ids of these."""
    if not job_ids:
        return {}
    query = select(jobs.c.reconstruction_id, jobs.c.id, jobs.c.state).where(jobs.c.reconstruction_id.in_(job_ids))
    return {row.reconstruction_id: NewestJob(row.id, JobState(row.state)) for row in connection.execute(query)}


def _num_blurred(connection: Connection, job_ids: Sequence[str]) -> Mapping[str, int]:
    """Numbers of blurred videos of jobs, by their ids."""
    if not job_ids:
        return {}
    query = select(results.c.job_id, func.count()).where(results.c.job_id.in_(job_ids), results.c.kind == BLURRED_KIND)
    return {row[0]: row[1] for row in connection.execute(query.group_by(results.c.job_id))}


def is_in_state(state: JobState) -> ColumnElement[bool]:
    """Condition that a job is in a state, as ``states.job_state`` tells it."""
    has_files = jobs.c.results_revision.is_not(None)
    if state is JobState.SUCCEEDED:
        return has_files & (jobs.c.state != JobState.EXPIRED)
    return (jobs.c.state == state) & (~has_files if state is not JobState.EXPIRED else true())


def _job(
    row: Row[Any],
    stages: tuple[StageProgress, ...],
    visuals_job: NewestJob | None,
    num_blurred: int,
    queue_position: int | None,
) -> JobRecord:
    spec = read_spec(row.spec)
    config = job_config(spec)
    preflight = Preflight.from_json(row.preflight)
    has_videos = not stages or any(stage.name == DETECT for stage in stages)
    making, character = read_making(row.kind, row.making), from_json(JobCharacter, row.character)
    return read(
        JobRecord,
        row,
        num_frames=preflight.timebase.num_frames,
        duration_s=preflight.duration_s,
        attempt_state=JobState(row.state),
        spec=spec,
        stages=stages,
        progress=sum(stage.done for stage in stages) / max(1, sum(stage.total for stage in stages)),
        queue_position=queue_position,
        eta_s=_eta_s(row, stages, config),
        warnings=(*preflight.findings, *method_warnings(config, has_videos), *map(Finding.from_json, row.warnings)),
        making=making,
        edits=read_edits(row.edits),
        newest_edits_revision=row.session_edits_revision or 0,
        has_old_visuals=row.visuals_old_at is not None,
        visuals_job=visuals_job,
        num_blurred=num_blurred,
        character=character,
        has_videos=row.videos_deleted_at is None,
        space=None
        if making is not None or preflight.timebase.num_frames == 0
        else foreseen_space(preflight, config, 0 if character is None else character.file.num_bytes),
    )


def read_spec(document: Mapping[str, Any]) -> JobSpec:
    """Spec of a job, from its column. Equal ones are checked once: a page of jobs has few different ones."""
    return _checked_spec(json.dumps(document))


@functools.lru_cache(1024)
def _checked_spec(document: str) -> JobSpec:
    return JobSpec.model_validate_json(document)


def read_edits(documents: Sequence[Mapping[str, Any]]) -> tuple[PeopleEdit, ...]:
    """Edits of a job's people, from their column."""
    return tuple(map(read_edit, documents))


_MAKINGS: Mapping[str, Callable[..., Making]] = {
    "calibration": CalibrationChoices,
    "proxies": ProxyChoices,
    "visuals": VisualChoices,
}


def read_making(kind: str, choices: Mapping[str, Any] | None) -> Making | None:
    """Choices of what a job makes, from its columns."""
    return None if choices is None else from_json(_MAKINGS[kind], choices)


def _eta_s(row: Row[Any], stages: Iterable[StageProgress], config: ReconstructionConfig) -> float | None:
    if row.state != JobState.RUNNING:
        return None
    left_s = time_left_s(stages, config, row.started_at + timedelta(seconds=max(0.0, row.elapsed_s)))
    return None if left_s is None else round(left_s, 1)


def _stages(connection: Connection, job_ids: Sequence[str]) -> Mapping[str, tuple[StageProgress, ...]]:
    rows = connection.execute(_select_stages(), {"job_ids": job_ids}).all()
    return {job_id: tuple(map(_stage, stages)) for job_id, stages in groupby(rows, key=itemgetter(0))}


@functools.cache
def _select_stages() -> Select[Any]:
    return (
        select(
            chunks.c.job_id,
            chunks.c.stage,
            func.sum(chunks.c.done_units),
            func.sum(chunks.c.unit_count),
            func.min(chunks.c.started_at),
            func.max(chunks.c.finished_at),
            _count(chunks.c.reused),
            func.count(func.distinct(chunks.c.worker)),
            func.count(),
            *(_count(chunks.c.state == state) for state in _STATES),
        )
        .where(chunks.c.job_id.in_(bindparam("job_ids", expanding=True)))
        .group_by(chunks.c.job_id, chunks.c.stage_index, chunks.c.stage)
        .order_by(chunks.c.job_id, chunks.c.stage_index)
    )


def _count(condition: ColumnElement[bool]) -> ColumnElement[int]:
    return func.sum(case((condition, 1), else_=0))


def _stage(row: Sequence[Any]) -> StageProgress:
    """Progress of a stage, from a row of ``_select_stages``: a page of jobs has hundreds of them."""
    _, name, done, total, started_at, finished_at, num_reused, num_workers, num_chunks, *of_states = row
    state = stage_state(compress(_STATES, of_states))
    return StageProgress(
        name=name,
        state=state,
        done=done,
        total=total,
        started_at=started_at,
        finished_at=finished_at if state in _ENDED else None,
        reused=num_reused == num_chunks,
        num_chunks=num_chunks,
        num_workers=max(1, num_workers),
    )


def stage_state(states: Iterable[ChunkState]) -> ChunkState:
    """State of a stage from the states of its chunks: the worst one, else running, else the shared one."""
    found = frozenset(states)
    for decisive in (ChunkState.FAILED, ChunkState.RUNNING, ChunkState.CANCELED):
        if decisive in found:
            return decisive
    if len(found) > 1:
        return ChunkState.RUNNING  # some chunks are done, the others wait for a worker
    return next(iter(found))


# Share of a stage after which its own rate tells more than the stages before it.
_TELLING = 0.05


def time_left_s(stages: Iterable[StageProgress], config: ReconstructionConfig, now: datetime) -> float | None:
    """Estimate the time that is left of a job whose attempt began; ``None`` before a unit is done.

    A stage that has begun continues at its own rate. Stages that follow take their foreseen work, times the ratio of
    measured to foreseen time so far: a busy machine has a large one. A stage uses as many of the job's workers as it
    has chunks. Outputs of an earlier job took no time.
    """
    at_work = [stage for stage in stages if not stage.reused]
    worked = [stage for stage in at_work if stage.done and stage.started_at is not None]
    num_workers = max((stage.num_workers for stage in worked), default=1)

    def foreseen_s(stage: StageProgress, num_units: int) -> float:
        return num_units * unit_s(stage.name, config) / min(stage.num_chunks, num_workers)

    def spent_s(stage: StageProgress) -> float:
        return ((stage.finished_at or now) - (stage.started_at or now)).total_seconds()

    done_s = sum(foreseen_s(stage, stage.done) for stage in worked)
    if not done_s:
        return None
    pace = sum(map(spent_s, worked)) / done_s
    return sum(
        spent_s(stage) / stage.done * (stage.total - stage.done)
        if stage.done > _TELLING * stage.total
        else foreseen_s(stage, stage.total - stage.done) * pace
        for stage in at_work
    )
