"""Plans of jobs: the pipeline's plan of a session and a spec, as rows of the store."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

from pipeline.capture.preflight_record import Preflight
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.edits import PeopleEdit
from pipeline.core.options.job_choices import VisualChoices
from pipeline.core.records import to_json
from pipeline.run.engine.code import stage_codes
from pipeline.run.engine.plan import STAGE_BY_NAME, PlannedStage, plan
from pipeline.run.engine.stage import SessionFacts, Task
from pipeline.run.space import foreseen_memory
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import JobRecord, Making, job_config
from worker.store.model.session_records import InputFile
from worker.store.model.work import ChunkPlan, Claim, Remake, StagePlan
from worker.store.spec import JobSpec


@runtime_checkable
class PlannableSession(Protocol):
    """A session whose files were checked; ``worker.store.model.session_records.Session``."""

    @property
    def files(self) -> tuple[InputFile, ...]:
        """Its files."""

    @property
    def preflight(self) -> Preflight:
        """Result of the check of its files."""

    @property
    def chunk_frames(self) -> int:
        """Frames of a camera in a chunk of each of its jobs."""


def plan_job(
    session: PlannableSession,
    spec: JobSpec,
    codes: Mapping[str, str] | None = None,
    making: Making | None = None,
    edits: tuple[PeopleEdit, ...] = (),
    revision: int = 0,
    character: JobCharacter | None = None,
    provider: str = "",
) -> tuple[StagePlan, ...]:
    """Cut a job into stages and chunks, one chunk a task; see ``pipeline.run.engine.plan.plan``.

    ``codes`` are digests of the stages' code, by default this process's for the execution provider of networks with the
    identity ``provider``; ``making``, ``edits``, ``revision`` and ``character`` are as in
    ``worker.store.model.job_records.JobRecord``.
    """
    return plan_config(session, job_config(spec, making, edits, revision, character), codes, provider)


def plan_config(
    session: PlannableSession,
    config: ReconstructionConfig,
    codes: Mapping[str, str] | None = None,
    provider: str = "",
) -> tuple[StagePlan, ...]:
    """Cut a job with a configuration into stages and chunks; see ``plan_job``."""
    stages = plan(session_facts(session), config, codes or stage_codes(provider), session.chunk_frames)
    memory = foreseen_memory(session.preflight, config)
    return tuple(
        StagePlan(
            stage.name,
            _Chunks(stage, memory.task_bytes(STAGE_BY_NAME[stage.name].cut)),
            stage.code_sha256,
            provider if STAGE_BY_NAME[stage.name].runs_networks else "",
        )
        for stage in stages
    )


def plan_visuals(session: PlannableSession, job: JobRecord) -> tuple[VisualChoices, tuple[StagePlan, ...]]:
    """Choices and plan of the job that rebuilds overlay videos, the report and the recording of a reconstruction.

    It also makes the blurred videos that are missing.
    """
    choices = VisualChoices(blurs_videos=job.num_blurred < len(session.preflight.cameras))
    return choices, plan_again(session, replace(job, making=choices), job.provider)


def plan_remake(session: PlannableSession, job: JobRecord) -> Remake:
    """Plan of a job whose files are made again."""
    visuals = [
        STAGE_BY_NAME[plan.name] for plan in plan_visuals(session, job)[1] if STAGE_BY_NAME[plan.name].makes_files
    ]
    reads_videos = any(stage.reads_videos for stage in visuals)
    return Remake(plan_again(session, job, job.provider), bool(visuals), reads_videos)


def plan_again(session: PlannableSession, job: JobRecord, provider: str = "") -> tuple[StagePlan, ...]:
    """Plan of a job that is there already, for an execution provider; see ``plan_job``."""
    return plan_job(
        session,
        job.spec,
        making=job.making,
        edits=job.edits,
        revision=job.revision,
        character=job.character,
        provider=provider,
    )


def session_facts(session: PlannableSession) -> SessionFacts:
    """Facts of a session that a plan depends on."""
    preflight = session.preflight
    return SessionFacts(
        inputs=_inputs(session),
        num_frames=preflight.timebase.num_frames,
        frame_rate_hz=preflight.timebase.frame_rate_hz,
        stretches=preflight.stretches,
        camera_rates_hz={camera.name: camera.frame_rate_hz for camera in preflight.cameras},
        has_videos=has_videos(session),
        has_points=has_points(session),
    )


def has_videos(session: PlannableSession) -> bool:
    """Return whether the client sent videos; else keypoints or 3D points."""
    return not any(file.kind in ("keypoints", "points") for file in session.files)


def has_points(session: PlannableSession) -> bool:
    """Return whether the client sent 3D points."""
    return any(file.kind == "points" for file in session.files)


def claimed_task(claim: Claim) -> Task:
    """Task of a claimed chunk."""
    payload = claim.payload
    return Task(
        stage=claim.stage,
        index=claim.index,
        camera=payload["camera"],
        frames=range(payload["start_frame"], payload["stop_frame"]),
        chunk_frames=payload["chunk_frames"],
        num_units=claim.unit_count,
        key=claim.output_key,
        piece_key=payload.get("piece_key", ""),
    )


@dataclass(frozen=True, slots=True)
class _Chunks:
    """Tasks of a stage as chunks, derived one at a time."""

    stage: PlannedStage
    memory_bytes: int  # Memory that each is foreseen to need

    def __iter__(self) -> Iterator[ChunkPlan]:
        for task in self.stage.tasks:
            payload = {
                "camera": task.camera,
                "start_frame": task.frames.start,
                "stop_frame": task.frames.stop,
                "chunk_frames": task.chunk_frames,
            }
            if task.piece_key:
                payload["piece_key"] = task.piece_key
            yield ChunkPlan(task.index, payload, task.num_units, task.key, self.memory_bytes)


def _inputs(session: PlannableSession) -> tuple[str, ...]:
    """Digests and names of the files, and what the client stated about them.

    Names count: files and cameras find each other by name.
    """
    files = sorted(f"{file.kind}/{file.name}/{file.sha256}" for file in session.files)
    if (units := session.preflight.units) != "m":
        files.append(units)
    if (up := session.preflight.up) != "z":
        files.append(f"up {up}")
    if (layout := session.preflight.layout) is not None:
        files.append(f"layout {layout.name}")
    if names := session.preflight.names:
        files.append(f"names {json.dumps(names, sort_keys=True)}")
    if not has_videos(session):
        return (*files, repr(session.preflight.timebase.frame_rate_hz))
    if (clock := session.preflight.clock) != "declared":
        files.append(clock)
    stated = (json.dumps(to_json(recording), sort_keys=True) for recording in session.preflight.recordings)
    return (*files, *sorted(stated))
