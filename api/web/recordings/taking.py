"""Sessions and calibrations from takes: clips that phones have uploaded become videos of cameras."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

from fastapi import Request
from starlette.concurrency import run_in_threadpool

from api.web.calibrations import intake
from api.web.contract.schemas import FindingOut
from api.web.dependencies import Services
from api.web.errors import ApiError, ErrorItem, unprocessable
from api.web.http.bodies.form import Form, Parts
from api.web.http.bodies.form_kinds import CALIBRATION_ID, MANIFEST, SPEC, VIDEOS, FormKind
from api.web.http.bodies.validation import NO_PLACES
from api.web.http.idempotency import Answer, IdempotentRequest
from api.web.jobs.queueing import accepted
from api.web.recordings.schemas import TakeCalibrationSpec, TakeSessionOut, TakeSessionSpec
from api.web.sessions.intake import check
from api.web.sessions.manifest import CameraManifest, Manifest
from api.web.sessions.receiving import Sent
from api.web.sessions.schemas import CAPTURE_FORM, SESSION_FORM, UploadedCapture, UploadedSession
from api.web.sessions.storing import CheckedSession, session_and_job, stored
from pipeline.core.findings import Finding
from pipeline.core.problems.finding_codes import CLIP_NOT_SENT, CLIP_OUTSIDE_TAKE, CLIP_PART_LEFT_OUT
from pipeline.core.problems.request_codes import CLIPS_MISSING, CONFLICT, UPLOAD_UNFINISHED, UPLOAD_UNKNOWN
from worker.store.errors import NotFound
from worker.store.model.phone_records import ClipFile, RecordingSession, RecordingTake, TakeState
from worker.store.tenant_records import TenantRecords

# A first frame that is further before or behind the take is one of a wrong clock.
_MAX_BESIDE_S = 60.0


@dataclass(frozen=True, slots=True)
class TakeVideos:
    """Videos of a take.

    ``files``: part of a clip of each camera that is used, by the name of its phone. ``names``: names of the files, by
    the name of the phone. ``warnings``: findings about clips that are not used.
    """

    files: Mapping[str, ClipFile]
    names: Mapping[str, str]
    offsets_s: Mapping[str, float]
    warnings: tuple[Finding, ...]

    def cameras(self) -> tuple[CameraManifest, ...]:
        """Cameras with the offsets of their first frames."""
        return tuple(
            CameraManifest(name=phone, file=self.names[phone], offset_s=self.offsets_s[phone], offset_std_s=file.std_s)
            for phone, file in self.files.items()
        )


def take_videos(recording: RecordingSession, take: RecordingTake) -> TakeVideos:
    """Videos of a take: of each phone its longest part, since a recording has no gaps.

    Raises ``ApiError`` if no phone has sent a clip of the take.
    """
    files, names, warnings = dict[str, ClipFile](), dict[str, str](), list[Finding]()
    for phone in recording.phones:
        clip = take.clip(phone.number)
        if clip is None or clip.longest is None:
            if clip is not None or not phone.is_removed:
                warnings.append(Finding(CLIP_NOT_SENT, f"{phone.name} has sent no clip of this take.", phone.name))
            continue
        if not -_MAX_BESIDE_S <= clip.longest.first_frame_s - take.start_s <= take.duration_s + _MAX_BESIDE_S:
            message = f"{phone.name}: its first frame is not within the take; its clock is wrong."
            warnings.append(Finding(CLIP_OUTSIDE_TAKE, message, phone.name))
            continue
        used = files[phone.name] = clip.longest
        names[phone.name] = f"phone-{phone.number}{_ending(used)}"
        for file in clip.files:
            if file is not used:
                message = f"part {file.part} with {file.duration_s:.1f} s is left out; part {used.part} is longer."
                warnings.append(Finding(CLIP_PART_LEFT_OUT, f"{phone.name}: {message}", phone.name))
    if not files:
        hint = "Ask the phones for it by `upload`, and wait until they have sent it."
        reasons = (warning.message for warning in warnings)
        raise ApiError(CLIPS_MISSING, " ".join(["There is no clip of this take.", *reasons]), hint=hint)
    offsets_s = {phone: round(file.first_frame_s - take.start_s, 6) for phone, file in files.items()}
    return TakeVideos(files, names, offsets_s, tuple(warnings))


def used_take(recording: RecordingSession, number: int, now_s: float) -> RecordingTake:
    """Take of which something is made; raises ``NotFound``, or ``ApiError`` while it is recorded."""
    take = recording.take(number)
    if take is None:
        raise NotFound("The recording has no such take.")
    if take.state(now_s) is TakeState.RECORDING:
        raise ApiError(CONFLICT, "The take is being recorded.", hint="Stop it first.")
    return take


async def made_session(
    request: Request,
    services: Services,
    idempotent: IdempotentRequest,
    recording: RecordingSession,
    take: RecordingTake,
    spec: TakeSessionSpec,
    folder: Path,
) -> Answer:
    """Make the session of a take, with its job if the spec has one; files go through ``folder``.

    Raises ``ApiError``: with all that is wrong.
    """
    records, kind = idempotent.records, SESSION_FORM if spec.job is None else CAPTURE_FORM
    name = spec.name or f"{recording.name}, {take.name}"
    if take.calibration_id is not None:
        content, videos = await run_in_threadpool(_as_calibrated, records, take, spec, name), None
        sent = Sent(folder, kind, content, None, NO_PLACES)
    else:
        videos = take_videos(recording, take)
        manifest = Manifest(name=name, cameras=videos.cameras(), sync="auto", metadata=_source(recording, take))
        documents = {MANIFEST: manifest.model_dump_json(), CALIBRATION_ID: str(spec.calibration_id)}
        if spec.job is not None:
            documents[SPEC] = spec.job.model_dump_json(exclude_unset=True)
        form = await _form(request, services, records, folder, kind, videos, documents)
        sent = Sent(folder, kind, form, None, NO_PLACES)
    try:
        checked = await check(request.state.caller.owner, services, records, sent)
    except ApiError as error:
        raise _without_pointers(error) from None
    if videos is not None:
        checked = replace(checked, upload_ids=_upload_ids(videos))
    return await run_in_threadpool(_add, services, idempotent, recording, take, checked, spec.job is not None, videos)


async def made_calibration(
    request: Request,
    services: Services,
    idempotent: IdempotentRequest,
    recording: RecordingSession,
    take: RecordingTake,
    spec: TakeCalibrationSpec,
    folder: Path,
) -> Answer:
    """Begin the calibration of a take's phones; files go through ``folder``.

    Raises ``ApiError``: with all that is wrong.
    """
    records, videos = idempotent.records, take_videos(recording, take)
    choices = spec.spec(tuple(camera.model_dump(mode="json") for camera in videos.cameras()), take.name)
    documents = {SPEC: json.dumps({name: value for name, value in choices.items() if value not in (None, [])})}
    form = await _form(request, services, records, folder, intake.CALIBRATION_FORM, videos, documents)
    sent = Sent(folder, intake.CALIBRATION_FORM, form, None, NO_PLACES)
    try:
        checked = await intake.check_calibration(request.state.caller.owner, services, records, sent)
    except ApiError as error:
        raise _without_pointers(error) from None
    if isinstance(checked.content, CheckedSession):
        checked = replace(checked, content=replace(checked.content, upload_ids=_upload_ids(videos)))
    return await run_in_threadpool(_begin, services, idempotent, recording, take, checked)


def _as_calibrated(
    records: TenantRecords, take: RecordingTake, spec: TakeSessionSpec, name: str
) -> UploadedSession | UploadedCapture:
    source_id = records.calibrations.get(str(take.calibration_id)).session_id
    if source_id is None:
        raise NotFound("The footage of the take's calibration was deleted.")
    named: dict[str, Any] = {
        "session_id": source_id,
        "calibration_id": spec.calibration_id,
        "manifest": Manifest(name=name, sync="auto"),
    }
    return UploadedSession(**named) if spec.job is None else UploadedCapture(**named, spec=spec.job)


async def _form(
    request: Request,
    services: Services,
    records: TenantRecords,
    folder: Path,
    kind: FormKind,
    videos: TakeVideos,
    documents: Mapping[str, str],
) -> Form:
    """Form with the videos of a take and with documents, as a client would send it."""
    owner = request.state.caller.owner
    # Large files are read once, for their digests, in the turn of the checks.
    form = await services.checks.run(owner, _adopted, services, records, folder, kind, videos, tuple(documents))
    return replace(form, documents={name: text.encode() for name, text in documents.items()})


def _adopted(
    services: Services,
    records: TenantRecords,
    folder: Path,
    kind: FormKind,
    videos: TakeVideos,
    documents: tuple[str, ...],
) -> Form:
    """Form with the videos of a take, whose files stay on their spool."""
    parts, problems = Parts(folder, services.limits, kind, NO_PLACES), list[ErrorItem]()
    for phone, file in videos.files.items():
        try:
            upload = records.uploads.get(file.upload_id)
            offset = services.uploads.offset(upload)
        except NotFound:
            problems.append(
                ErrorItem(
                    code=UPLOAD_UNKNOWN,
                    message=f"The upload of {phone} is gone: its time is over, or it was deleted.",
                    camera=phone,
                    hint="Open the phone's page again: it sends the clip if it has it. Else discard the take.",
                )
            )
            continue
        except ApiError as error:  # its bytes are elsewhere
            problems.append(ErrorItem(code=error.code, message=error.detail, camera=phone, hint=error.hint))
            continue
        if offset < upload.num_bytes:
            message = f"Of the clip of {phone} {offset} of {upload.num_bytes} bytes have come."
            hint = "Wait until the phone has sent the rest."
            problems.append(ErrorItem(code=UPLOAD_UNFINISHED, message=message, camera=phone, hint=hint))
            continue
        parts.adopt(VIDEOS, videos.names[phone], services.uploads.file(upload))
    if problems:
        raise unprocessable(problems)
    return parts.form(documents)


def _add(
    services: Services,
    idempotent: IdempotentRequest,
    recording: RecordingSession,
    take: RecordingTake,
    checked: CheckedSession,
    has_job: bool,
    videos: TakeVideos | None,
) -> Answer:
    """Record the session of a take, with its job, and that it was made of the take; all or nothing."""
    if has_job:
        with session_and_job(services, idempotent.records, checked) as (work, job):
            work.recordings.use_take(recording.id, take.number, session_id=job.session_id, job_id=job.id)
            return idempotent.store(work, _made(job.session_id, job.id, checked, videos))
    with stored(services, checked) as new, idempotent.records.transaction() as work:
        session = new.add_to(work)
        work.recordings.use_take(recording.id, take.number, session_id=session.id)
        return idempotent.store(work, _made(session.id, None, checked, videos))


def _begin(
    services: Services,
    idempotent: IdempotentRequest,
    recording: RecordingSession,
    take: RecordingTake,
    checked: intake.CheckedCalibration,
) -> Answer:
    with intake.begun_calibration(services, idempotent.records, checked) as (work, job):
        work.recordings.use_take(recording.id, take.number, calibration_id=job.id)
        return idempotent.store(work, accepted(job))


def _made(session_id: str, job_id: str | None, checked: CheckedSession, videos: TakeVideos | None) -> Answer:
    body = TakeSessionOut(
        session_id=session_id,
        job_id=job_id,
        cameras={recording.camera: recording.offset_s for recording in checked.preflight.recordings},
        warnings=() if videos is None else tuple(map(FindingOut.from_record, videos.warnings)),
    )
    return Answer(201, {"Location": f"/v1/sessions/{session_id}"}, body.model_dump_json())


def _upload_ids(videos: TakeVideos) -> tuple[str, ...]:
    return tuple(file.upload_id for file in videos.files.values())


def _source(recording: RecordingSession, take: RecordingTake) -> dict[str, Any]:
    return {"recording_id": recording.id, "take": take.number}


def _ending(file: ClipFile) -> str:
    kind = PurePosixPath(str(file.facts.get("mime_type") or "").partition(";")[0]).name
    return {"webm": ".webm", "x-matroska": ".mkv"}.get(kind, ".mp4")


def _without_pointers(error: ApiError) -> ApiError:
    """Error about the parts of a form, for a client that sent none."""
    error.errors = tuple(item.model_copy(update={"pointer": None}) for item in error.errors)
    return error
