"""New jobs: check of a spec, copy of its character, space on the disk, plan, and the queue."""

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit
from uuid import UUID

import structlog

from api.web.characters.intake import character_download
from api.web.dependencies import POLL_AFTER_S, Services
from api.web.downloads import opened
from api.web.errors import ApiError
from api.web.http.idempotency import Answer
from api.web.jobs.schemas import JobOut
from pipeline.capture.preflight_record import Preflight
from pipeline.core.errors import Problem
from pipeline.core.findings import CERTAIN
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.options.job_choices import ProxyChoices
from pipeline.core.options.rules import Installed, installation_problems, session_problems
from pipeline.core.problems import request_codes
from pipeline.run.space import foreseen_space, shown_bytes
from worker.run import tracing
from worker.run.planning import PlannableSession, has_videos, plan_config, plan_job
from worker.run.webhooks.addresses import may_be_public, url_fault
from worker.store.errors import Conflict, NotFound
from worker.store.files.file_keys import job_character_key, job_prefix
from worker.store.model.character_records import JobCharacter
from worker.store.model.job_records import JobRecord, job_config
from worker.store.model.session_records import SessionEdits
from worker.store.model.work import StagePlan
from worker.store.outages import undo_on_failure
from worker.store.repositories.work.workers import shared_by_ready
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class SpecLimits:
    """Limits of the service for the specs of a tenant's jobs."""

    installed: Installed  # On every worker
    allows_private_webhooks: bool
    records: TenantRecords  # With the tenant's characters and the secret of its webhooks


class QueuedSession(PlannableSession, Protocol):
    """A session with an id."""

    @property
    def id(self) -> str:
        """Its id."""

    @property
    def arrival(self) -> Mapping[str, Any] | None:
        """Its request while its videos are fetched."""


def installed_on_workers(services: Services, *, has_videos: bool) -> Installed:
    """Names that every worker has installed; without workers nothing is known, and jobs wait for one.

    Only sessions of videos need networks.
    """
    workers = services.store.workers.all()
    networks = shared_by_ready(workers, "detectors") if has_videos else None
    return Installed(networks, shared_by_ready(workers, "bodies"), shared_by_ready(workers, "formats"))


def spec_limits(services: Services, records: TenantRecords, *, has_videos: bool) -> SpecLimits:
    """Limits of the service for the jobs of a session."""
    installed = installed_on_workers(services, has_videos=has_videos)
    return SpecLimits(installed, services.settings.webhook_private, records)


def with_session_choices(spec: JobSpec, preflight: Preflight) -> JobSpec:
    """Spec with the session's synchronisation and frames of the files, unless the client stated them."""
    session_choices = {"sync": preflight.sync, "timeline": preflight.timeline}
    stated = spec.model_fields_set
    return spec.model_copy(update={name: value for name, value in session_choices.items() if name not in stated})


def check_spec(spec: JobSpec, session: Preflight | None, limits: SpecLimits) -> list[Problem]:
    """Find everything that is wrong with the spec of a job.

    Problems of choices have their field. A job without ``force`` is also refused for errors of the session with which
    no person could be located; the job judges the other errors with the people.

    ``session``: session of the job; ``None`` if its files are wrong.
    """
    problems = []
    if session is not None:
        problems += [
            Problem(finding.code, finding.message, camera=finding.camera, hint=finding.hint)
            for finding in (() if spec.force else session.findings)
            if finding.severity == "error" and finding.code in CERTAIN
        ]
        problems += session_problems(spec.config, session.timebase.num_frames, session.timebase.frame_rate_hz)
    problems += installation_problems(spec.config, limits.installed)
    if spec.callback_url is not None:
        if fault := url_fault(spec.callback_url):
            problems.append(Problem(request_codes.CALLBACK_INVALID, fault, field="callback_url"))
        elif not limits.allows_private_webhooks:
            address = urlsplit(spec.callback_url)
            if address.scheme != "https":
                message = "Webhooks go to https addresses only."
                problems.append(Problem(request_codes.CALLBACK_NOT_HTTPS, message, field="callback_url"))
            if not may_be_public(address.hostname or ""):
                message = "Webhooks go to public addresses only."
                problems.append(Problem(request_codes.CALLBACK_NOT_PUBLIC, message, field="callback_url"))
        if not limits.records.has_webhook_secret():
            message = "There is no secret to sign webhooks with."
            hint = "Have the operator make one with `multicap webhooks rotate`."
            problems.append(Problem(request_codes.WEBHOOK_SECRET_MISSING, message, field="callback_url", hint=hint))
    if spec.character is not None:
        try:
            limits.records.characters.get(str(spec.character))
        except NotFound:
            message, hint = "There is no such character.", "GET /v1/characters lists them."
            problems.append(Problem(request_codes.CHARACTER_UNKNOWN, message, field="character", hint=hint))
    return problems


@contextlib.contextmanager
def queued_job(
    services: Services,
    records: TenantRecords,
    session: QueuedSession,
    spec: JobSpec,
    files: AbstractContextManager[object] | None = None,
    record_session: Callable[[TenantRecords], object] | None = None,
) -> Iterator[tuple[TenantRecords, JobRecord]]:
    """Plan a reconstruction and queue it, beside the job of the session's proxies.

    The block gets the open transaction and the job. A worker is woken after it.

    ``files``, ``record_session``: store the files of a new session, and record it in the same transaction as its job.
    Raises ``Conflict`` if the character was deleted meanwhile. Raises ``ApiError`` if its file is missing or damaged,
    or the disk has too little space.
    """
    has_edits = record_session is None and spec.apply_edits
    edits = records.edits.get(session.id) if has_edits else SessionEdits()
    with copied_character(services, records, spec.character) as moved:
        character = None if moved is None else moved[1]
        config = job_config(spec, edits=edits.edits, character=character)
        stages: tuple[StagePlan, ...] = ()
        if session.arrival is None:
            stages = planned(services, session, config, services.store.workers.provider(), character)
        with files or contextlib.nullcontext(), records.transaction() as work:
            if record_session is not None:
                record_session(work)
            retention_s = services.settings.retention_s
            job = work.jobs.add(session.id, spec, stages, retention_s, tracing.current(), moved=moved, edits=edits)
            queue_proxies(work, session)
            yield work, job
    _log.info("job_created", job=job.id, session=job.session_id)
    # When the broker is away, the reaper publishes later.
    services.queue.publish()


def planned(
    services: Services,
    session: PlannableSession,
    config: ReconstructionConfig,
    provider: str,
    character: JobCharacter | None,
) -> tuple[StagePlan, ...]:
    """Plan a job; raises ``ApiError`` if the disk has too little space for it."""
    character_bytes = 0 if character is None else character.file.num_bytes
    needed_bytes = foreseen_space(session.preflight, config, character_bytes).store_bytes
    # Of a bucket nothing is known; the space that workers need meanwhile is on their own disks.
    if not services.settings.artifacts_url and not services.disk.has_room(needed_bytes):
        free = shown_bytes(max(0, services.disk.free_bytes - services.disk.headroom_bytes))
        raise ApiError(
            request_codes.SPACE_MISSING,
            f"The job needs about {shown_bytes(needed_bytes)}, and the service's disk has {free}.",
            hint="Delete captures that are no longer needed, ask for fewer files, or reconstruct fewer frames at a "
            "time by frame_range.",
            retryable=True,
        )
    return plan_config(session, config, provider=provider)


@contextlib.contextmanager
def copied_character(
    services: Services, records: TenantRecords, character_id: UUID | None, job_id: str | None = None
) -> Iterator[tuple[str, JobCharacter] | None]:
    """Copy the character of a job: its file stays what it is when the character is changed or deleted.

    ``job_id`` is a job that is there; ``None``: a new one. The block gets the new job's id, or the prefix of the copy,
    and records the copy. If it fails, the copy is removed; the reaper removes the copy of a process that is killed in
    between.
    """
    if character_id is None:
        yield None
        return
    try:
        character = records.characters.get(str(character_id))
    except NotFound:
        raise Conflict("The character was deleted meanwhile.") from None
    services.disk.require_room(character.file.num_bytes)
    if job_id is None:
        place = services.store.jobs.reserve_id()
        prefix, key = job_prefix(place), job_character_key(place)
    else:
        place = prefix = records.jobs.reserve_copy(job_id)
        key = f"{prefix}file"
    file = replace(character.file, key=key)
    with undo_on_failure() as undo:
        undo.callback(services.artifacts.delete_prefix, prefix)
        services.settings.spool_dir.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=services.settings.spool_dir) as folder:
            path = Path(folder) / "file"
            with opened(services, character_download(character)) as source, path.open("xb") as copy:
                shutil.copyfileobj(source, copy)
            services.artifacts.put_file(file.key, path)
        yield place, JobCharacter(character.id, file, character.corrections)


def accepted(job: JobRecord) -> Answer:
    """Answer that a job is queued."""
    headers = {"Location": f"/v1/jobs/{job.id}", "Retry-After": str(POLL_AFTER_S)}
    return Answer(202, headers, JobOut.from_job(job).model_dump_json())


def queue_proxies(work: TenantRecords, session: QueuedSession) -> None:
    """Queue the job that makes a session's proxies, in an open transaction, unless there is one or none is needed.

    Of a session with a job that blurs faces, only blurred videos are shown, and of deleted videos there are no copies.
    """
    cameras = tuple(camera.name for camera in session.preflight.cameras if camera.media_type is None)
    if not cameras or not has_videos(session) or work.jobs.page(session_id=session.id, kind="proxies", limit=1):
        return
    capture = work.sessions.capture(session.id)
    if capture.blurs_faces or capture.session.videos_deleted_at is not None:
        return
    making = ProxyChoices(cameras)
    work.jobs.add(session.id, JobSpec(), plan_job(session, JobSpec(), making=making), None, tracing.current(), making)
