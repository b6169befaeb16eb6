"""From a form, or from uploads, to a session: receive, check, keep. All or nothing."""

import contextlib
import hashlib
import json
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar
from urllib.parse import urlsplit

import anyio
import uuid_utils
from fastapi import Request, Response
from opentelemetry import trace
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool

from api.dependencies import Services
from api.errors import ApiError, ErrorItem, pointer_to, unprocessable
from api.requests.bodies import announced_bytes, limited
from api.requests.form import CALIBRATION, KEYPOINTS, TIMESTAMPS, VIDEOS, Form, Parts, ReceivedFile
from api.requests.idempotency import Once, respond
from api.requests.multipart import receive_form
from api.requests.preflight import InvalidFilesError, allowance_s, further_wait_s
from api.requests.validation import model_items
from api.schemas import Manifest, UploadedCapture, UploadedSession
from pipeline.config import install_command
from worker.jobs.errors import NotFound
from worker.jobs.files.artifacts import input_key, record_key, session_prefix
from worker.jobs.model import InputFile
from worker.jobs.repositories.idempotency_keys import Answer
from worker.jobs.repositories.records import Records
from worker.jobs.repositories.workers import installed_detectors
from worker.jobs.spec import JobSpec
from worker.webhooks.addresses import may_be_public, url_fault

MANIFEST, SPEC = "manifest", "spec"

# What a file is called in a session where the form's part has another name.
_KINDS = {VIDEOS: "video", KEYPOINTS: KEYPOINTS}

# Fields of a camera in the manifest that problems of its frame times are of.
_OF_CAMERA = {"offset_s", "rate"}

_tracer = trace.get_tracer("multicap")

_Model = TypeVar("_Model", bound=BaseModel)
_Recorded = TypeVar("_Recorded")


@dataclass(frozen=True, slots=True)
class Arrival:
    """What a client sent.

    Parameters
    ----------
    manifest, spec
        ``None`` where they are wrong; ``errors`` then says why.
    upload_ids
        What the files were before.
    """

    form: Form
    manifest: Manifest | None
    spec: JobSpec | None
    errors: tuple[ErrorItem, ...] = ()
    upload_ids: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NewSession:
    """A session that is in the artifact store and not in the database yet, and how it is to be reconstructed."""

    id: str
    name: str
    files: tuple[InputFile, ...]
    preflight: Mapping[str, Any]
    upload_ids: tuple[str, ...]
    spec: JobSpec
    metadata: Mapping[str, Any]
    record_sha256: str


async def take_in(
    request: Request,
    services: Services,
    once: Once,
    documents: frozenset[str],
    record: Callable[[Records, NewSession], _Recorded],
    render: Callable[[_Recorded], Answer],
) -> Response:
    """Receive a session as a form, or as JSON that names uploads; check it, keep it, record it; once.

    Parameters
    ----------
    once
        Whose session it becomes.
    documents
        Its JSON parts: ``manifest``, and ``spec`` if it is to be reconstructed at once.
    record
        Writes it to the database.
    render
        Says what was recorded.

    Raises
    ------
    ApiError
        If anything is wrong; then nothing is kept, but uploads stay.
    """
    names_uploads = request.headers.get("content-type", "").partition(";")[0].strip().lower() == "application/json"
    to_come = 0 if names_uploads else announced_bytes(request)
    # A request that comes again may need no more room than there is.
    is_answered = await run_in_threadpool(once.is_answered)
    owner = request.state.caller.owner
    if not is_answered:
        services.checks.require_room(owner)
        await run_in_threadpool(once.records.require_room, to_come, unfinished_jobs=int(SPEC in documents))
    async with _folder(services.settings.spool_dir) as folder:
        if names_uploads:
            if not is_answered:
                services.disk.require_room()
            sent = await _receive_names(request, services, documents)
            parts: object = sent.model_dump(mode="json")
        else:
            form = await receive_form(request, folder, services.limits, documents, services.disk)
            parts = _parts_of(form)
        if (before := await run_in_threadpool(once.claim, parts, render)) is not None:
            return before
        async with once.held():
            # Large files are read once, for their digests, in the turn of the checks.
            arrival = (
                await services.checks.run(owner, _adopt, services, once.records, folder, sent)
                if names_uploads
                else _parsed(form)
            )
            recorded = await _check_and_keep(services, once.records, owner, folder, arrival, SPEC in documents, record)
    return respond(render(recorded))


async def _check_and_keep(
    services: Services,
    records: Records,
    owner: str,
    folder: Path,
    arrival: Arrival,
    with_job: bool,
    record: Callable[[Records, NewSession], _Recorded],
) -> _Recorded:
    form, errors = arrival.form, [*arrival.form.errors, *arrival.errors]
    if form.keypoints and arrival.manifest and arrival.manifest.cameras:
        message = "Keypoints have timestamps, and their archives the cameras' names: nothing else can be said of them."
        errors.append(ErrorItem(code="cameras_of_keypoints", message=message, pointer=f"/{MANIFEST}/cameras"))
    preflight: Mapping[str, Any] = {}
    record_path = folder / f"{uuid_utils.uuid7()}.npz"  # no file of the client's has such a name
    if not form.errors:
        try:
            with _tracer.start_as_current_span("preflight"):
                preflight = await services.checks.run(
                    owner,
                    services.preflight.check,
                    _arguments(form, arrival.manifest or Manifest(), services.settings.max_session_joints),
                    record_path,
                    allowance_s(form),
                    further_wait_s=further_wait_s(form),
                )
        except InvalidFilesError as invalid:
            errors.extend(_located(item, form, arrival.manifest or Manifest()) for item in invalid.errors)
    if preflight:
        errors.extend(_beyond_limits(services, preflight))
    if preflight and arrival.spec:
        errors.extend(spec_errors(arrival.spec, preflight, SPEC))
    if arrival.spec:
        errors.extend(await run_in_threadpool(callback_errors, arrival.spec, services, records, SPEC))
    if arrival.spec and with_job and not form.keypoints:
        errors.extend(await run_in_threadpool(detector_errors, arrival.spec, services, pointer_to(SPEC, "detector")))
    if errors or arrival.manifest is None or arrival.spec is None:
        raise unprocessable(errors)
    return await run_in_threadpool(
        _keep, services, records, arrival, arrival.manifest, arrival.spec, preflight, record_path, record
    )


def spec_errors(spec: JobSpec, preflight: Mapping[str, Any], *field: str) -> list[ErrorItem]:
    """What of a spec can't be done with a session; ``field`` is where the spec is in what the client sent."""
    timebase = preflight["timebase"]
    problems = spec.problems(timebase["num_frames"], timebase["frame_rate_hz"])
    return [
        ErrorItem(pointer=pointer_to(*field, name), code=code, message=message)
        for name, (code, message) in problems.items()
    ]


def _beyond_limits(services: Services, preflight: Mapping[str, Any]) -> list[ErrorItem]:
    """What of a session is longer or finer than the operator allows."""
    settings, timebase = services.settings, preflight["timebase"]
    duration_s = timebase["num_frames"] / timebase["frame_rate_hz"]
    found = []
    if settings.max_duration_s is not None and duration_s > settings.max_duration_s:
        message = f"The session lasts {duration_s:.2f} s; at most {settings.max_duration_s:g} s are taken."
        found.append(ErrorItem(code="session_too_long", message=message, hint="Cut it into several sessions."))
    if settings.max_pixels is not None:
        for camera in preflight["cameras"]:
            width, height = camera["size_px"]
            if width * height > settings.max_pixels:
                message = f"Its frames have {width} x {height} pixels; at most {settings.max_pixels} are taken."
                item = ErrorItem(code="frames_too_large", message=message, file=camera["file"], camera=camera["name"])
                found.append(item)
    return found


def callback_errors(spec: JobSpec, services: Services, records: Records, *field: str) -> list[ErrorItem]:
    """Why nobody could be told at a spec's address; ``field`` as above."""
    if spec.callback_url is None:
        return []
    found: list[tuple[str, str, str | None]] = []
    if fault := url_fault(spec.callback_url):
        found.append(("callback_invalid", fault, None))
    elif not services.settings.webhook_private:
        address = urlsplit(spec.callback_url)
        if address.scheme != "https":
            found.append(("callback_not_https", "Webhooks go to https addresses only.", None))
        if not may_be_public(address.hostname or ""):
            found.append(("callback_not_public", "Webhooks go to public addresses only.", None))
    if not records.has_webhook_secret():
        hint = "Have the operator make one with `multicap webhooks rotate`."
        found.append(("webhook_secret_missing", "There is no secret to sign webhooks with.", hint))
    pointer = pointer_to(*field, "callback_url")
    return [ErrorItem(code=code, message=message, pointer=pointer, hint=hint) for code, message, hint in found]


def detector_errors(spec: JobSpec, services: Services, pointer: str | None) -> list[ErrorItem]:
    """Refuse a detector that no worker has installed; without any worker nobody knows, and the job waits for one.

    For sessions of videos; ``pointer`` is where the detector is in what the client sent, if it is there.
    """
    installed = installed_detectors(services.store.workers())
    if installed is None or spec.detector in installed:
        return []
    message = f"The detector {spec.detector} is not installed."
    hint = install_command(spec.detector)
    return [ErrorItem(code="detector_not_installed", message=message, pointer=pointer, hint=hint)]


@contextlib.asynccontextmanager
async def _folder(spool_dir: Path) -> AsyncIterator[Path]:
    """A folder of the spool, gone at the end with all that is in it."""
    folder = spool_dir / str(uuid_utils.uuid7())
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(shutil.rmtree, folder)


def _parsed(form: Form) -> Arrival:
    """A form with its JSON parts parsed."""
    manifest, manifest_errors = _document(form, MANIFEST, Manifest)
    spec, spec_problems = _document(form, SPEC, JobSpec)
    return Arrival(form, manifest, spec, (*manifest_errors, *spec_problems))


def _document(form: Form, part: str, model: type[_Model]) -> tuple[_Model | None, list[ErrorItem]]:
    """Parse a JSON part; without it, all is as by default."""
    try:
        return model.model_validate_json(form.documents.get(part, b"{}")), []
    except ValidationError as error:
        return None, model_items(error.errors(), model, part)


def _parts_of(form: Form) -> object:
    """What a form holds, however it was sent."""
    files = {pointer: [file.name, file.sha256] for pointer, file in _files(form).items()}
    return files, {name: content.decode(errors="replace") for name, content in form.documents.items()}


async def _receive_names(request: Request, services: Services, documents: frozenset[str]) -> UploadedSession:
    body = await limited(request, services.settings.max_json_bytes).body()
    model = UploadedCapture if SPEC in documents else UploadedSession
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        if any(detail["type"] == "json_invalid" for detail in error.errors()):
            raise ApiError(400, "malformed_json", "The body is not JSON.") from None
        raise unprocessable(model_items(error.errors(), model)) from None


def _adopt(services: Services, records: Records, folder: Path, sent: UploadedSession) -> Arrival:
    """Take in the files of uploads, which stay where they are."""
    parts = Parts(folder, services.limits, frozenset())
    named = [(VIDEOS, one) for one in sent.videos] + [(KEYPOINTS, one) for one in sent.keypoints]
    named += [(part, one) for part, one in ((CALIBRATION, sent.calibration), (TIMESTAMPS, sent.timestamps)) if one]
    for part, upload_id in named:
        try:
            upload = records.upload(str(upload_id))
            num_bytes = services.uploads.offset(upload.id)
        except NotFound:
            message = "There is no such upload."
            parts.lack(part, "upload_unknown", message, "It may have been used, or its time is over: send it again.")
            continue
        if num_bytes < upload.num_bytes:
            message = f"Of this upload {num_bytes} of {upload.num_bytes} bytes have come."
            parts.lack(part, "upload_unfinished", message, "Send the rest of it first.", upload.name)
        else:
            parts.adopt(part, upload.name, services.uploads.path(upload.id))
    spec = sent.spec if isinstance(sent, UploadedCapture) else JobSpec()
    upload_ids = tuple(sorted({str(upload_id) for _, upload_id in named}))
    return Arrival(parts.form(), sent.manifest, spec, upload_ids=upload_ids)


def _files(form: Form) -> dict[str, ReceivedFile]:
    """All files of the form by their pointers."""
    views = ((VIDEOS, form.videos), (KEYPOINTS, form.keypoints))
    files = {f"/{part}/{index}": file for part, several in views for index, file in enumerate(several)}
    for part, one in ((CALIBRATION, form.calibration), (TIMESTAMPS, form.timestamps)):
        if one is not None:
            files[f"/{part}"] = one
    return files


def _arguments(form: Form, manifest: Manifest, max_joints: int) -> list[str]:
    """Arguments of the check of a session's files."""
    paths: dict[str, list[str]] = {}
    for pointer, file in _files(form).items():
        paths.setdefault(pointer.split("/")[1], []).append(str(file.path))
    arguments = [word for part, names in paths.items() for word in (f"--{part}", *names)]
    if manifest.units != "m":
        arguments.append(f"--units={manifest.units}")
    if manifest.cameras:
        said = [
            {"camera": one.name, "file": one.file, "offset_s": one.offset_s, "frame_rate_hz": one.rate}
            for one in manifest.cameras
        ]
        arguments.append(f"--recordings={json.dumps(said, ensure_ascii=False)}")
    if manifest.frame_rate_hz is not None:
        arguments.append(f"--frame-rate={manifest.frame_rate_hz!r}")
    if form.keypoints:
        arguments.append(f"--max-joints={max_joints}")
    return arguments


def _located(item: ErrorItem, form: Form, manifest: Manifest) -> ErrorItem:
    """Point from a problem to what the client sent: the manifest's entry of a camera, or a file's part of the form.

    An archive's part stands for what is in it. Of several entries of a camera the last one is the wrong one.
    """
    of_camera = [index for index, one in enumerate(manifest.cameras) if one.name == item.camera]
    if of_camera and (item.code.startswith("recording_") or item.field in _OF_CAMERA):
        stated = manifest.cameras[of_camera[-1]].model_fields_set
        field = [item.field] if item.field in stated else []
        return item.model_copy(update={"pointer": pointer_to(MANIFEST, "cameras", of_camera[-1], *field)})
    pointers = {file.name: pointer for pointer, file in _files(form).items()}
    of_archive = {PurePosixPath(file.name).stem: pointers[file.name] for file in form.keypoints}
    file = item.file or ""
    pointer = pointers.get(file) or of_archive.get(file.split("/")[0])
    return item.model_copy(update={"pointer": pointer})


def _keep(
    services: Services,
    records: Records,
    arrival: Arrival,
    manifest: Manifest,
    spec: JobSpec,
    preflight: Mapping[str, Any],
    record_path: Path,
    record: Callable[[Records, NewSession], _Recorded],
) -> _Recorded:
    """Move the files to the artifact store, then say so in the database; neither without the other.

    Whoever is killed in between has announced them, so that they go.
    """
    session_id = services.store.announce_session()
    received = [
        (_KINDS.get(pointer.split("/")[1], pointer[1:]), file) for pointer, file in _files(arrival.form).items()
    ]
    files = tuple(_input_file(session_id, index, kind, file) for index, (kind, file) in enumerate(received))
    with contextlib.ExitStack() as undo:
        undo.callback(services.artifacts.delete_prefix, session_prefix(session_id))
        for file, (_, source) in zip(files, received, strict=True):
            services.artifacts.put_file(file.key, source.path)
        with record_path.open("rb") as content:
            record_sha256 = hashlib.file_digest(content, "sha256").hexdigest()
        services.artifacts.put_file(record_key(session_id), record_path)
        new = NewSession(
            id=session_id,
            name=manifest.name,
            files=files,
            preflight=preflight,
            upload_ids=arrival.upload_ids,
            spec=spec,
            metadata=manifest.metadata,
            record_sha256=record_sha256,
        )
        recorded = record(records, new)
        undo.pop_all()
    for upload_id in arrival.upload_ids:
        services.uploads.remove(upload_id)
    return recorded


def _input_file(session_id: str, index: int, kind: str, file: ReceivedFile) -> InputFile:
    key = input_key(session_id, index, file.name)
    return InputFile(name=file.name, kind=kind, key=key, num_bytes=file.num_bytes, sha256=file.sha256)
