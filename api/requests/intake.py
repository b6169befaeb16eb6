"""Intake of sessions, from a form or from uploads: receive, check, store."""

import contextlib
import hashlib
import json
import shutil
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import anyio
import uuid_utils
from fastapi import Request
from opentelemetry import trace
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool

from api.dependencies import Services
from api.errors import ApiError, ErrorItem, pointer_to, unprocessable
from api.requests.bodies import announced_bytes, limited
from api.requests.form import CALIBRATION, KEYPOINTS, TIMESTAMPS, VIDEOS, Form, Parts, ReceivedFile
from api.requests.idempotency import IdempotentRequest
from api.requests.multipart import receive_form
from api.requests.preflight import InvalidFilesError, allowance_s, further_wait_s
from api.requests.spec_checks import callback_errors, limit_errors, network_errors, spec_errors
from api.requests.validation import model_items
from api.schemas import Manifest, UploadedCapture, UploadedSession
from pipeline.capture.preflight_record import Preflight
from worker.jobs.errors import NotFound
from worker.jobs.files.artifacts import input_key, record_key, session_prefix
from worker.jobs.model import InputFile
from worker.jobs.spec import JobSpec
from worker.jobs.tenant_records import TenantRecords

MANIFEST, SPEC = "manifest", "spec"

# Kinds of files that differ from the name of the form's part.
_KINDS = {VIDEOS: "video", KEYPOINTS: KEYPOINTS}

# Fields of a camera in the manifest that determine its frame times.
_OF_CAMERA = {"offset_s", "rate"}

_tracer = trace.get_tracer("multicap")

_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Sent:
    """A session as a client sent it, in a folder of the spool.

    Parameters
    ----------
    folder
        Holds the files of a form; gone with the request.
    content
        Parsed form, or names of uploads.
    parts
        JSON of the content, for the fingerprint of the request.
    with_job
        Whether the session is to be reconstructed at once.
    """

    folder: Path
    content: Form | UploadedSession
    parts: object
    with_job: bool


@dataclass(frozen=True, slots=True)
class Arrival:
    """Files of a session with its documents.

    Parameters
    ----------
    manifest, spec
        ``None`` where they are wrong; ``errors`` then says why.
    upload_ids
        Uploads that the files are from.
    """

    form: Form
    manifest: Manifest | None
    spec: JobSpec | None
    errors: tuple[ErrorItem, ...] = ()
    upload_ids: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CheckedSession:
    """A session without errors whose files are not in the artifact store yet.

    Parameters
    ----------
    record_path
        File that the preflight wrote for the workers.
    """

    form: Form
    manifest: Manifest
    spec: JobSpec
    preflight: Preflight
    record_path: Path
    upload_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NewSession:
    """A session that is in the artifact store and not in the database yet."""

    id: str
    name: str
    files: tuple[InputFile, ...]
    preflight: Preflight
    upload_ids: tuple[str, ...]
    metadata: Mapping[str, Any]
    record_sha256: str


@contextlib.asynccontextmanager
async def received(
    request: Request, services: Services, idempotent: IdempotentRequest, documents: frozenset[str]
) -> AsyncIterator[Sent]:
    """Receive a session as a form, or as JSON that names uploads; its files are there inside the block.

    Parameters
    ----------
    documents
        Its JSON parts: ``manifest``, and ``spec`` if it is to be reconstructed at once.

    Raises
    ------
    ApiError
        If there is no room for the session, or the request can't be read.
    """
    names_uploads = request.headers.get("content-type", "").partition(";")[0].strip().lower() == "application/json"
    to_come = 0 if names_uploads else announced_bytes(request)
    with_job = SPEC in documents
    # A request that comes again may need no more room than there is.
    is_answered = await run_in_threadpool(idempotent.is_answered)
    if not is_answered:
        services.checks.require_room(request.state.caller.owner)
        await run_in_threadpool(idempotent.records.require_room, to_come, unfinished_jobs=int(with_job))
    async with _folder(services.settings.spool_dir) as folder:
        if names_uploads:
            if not is_answered:
                services.disk.require_room()
            names = await _receive_names(request, services, documents)
            yield Sent(folder, names, names.model_dump(mode="json"), with_job)
        else:
            form = await receive_form(request, folder, services.limits, documents, services.disk)
            yield Sent(folder, form, _parts_of(form), with_job)


async def check(request: Request, services: Services, records: TenantRecords, sent: Sent) -> CheckedSession:
    """Check a session: its files by the preflight, its documents, and both against the limits of the service.

    Raises
    ------
    ApiError
        With all that is wrong.
    """
    owner = request.state.caller.owner
    if isinstance(sent.content, Form):
        arrival = _parsed(sent.content)
    else:
        # Large files are read once, for their digests, in the turn of the checks.
        arrival = await services.checks.run(owner, _adopt, services, records, sent.folder, sent.content)
    form, errors = arrival.form, [*arrival.form.errors, *arrival.errors]
    if form.keypoints and arrival.manifest and arrival.manifest.cameras:
        message = "Keypoints have timestamps, and their archives the cameras' names: nothing else can be said of them."
        errors.append(ErrorItem(code="cameras_of_keypoints", message=message, pointer=f"/{MANIFEST}/cameras"))
    preflight: Preflight | None = None
    record_path = sent.folder / f"{uuid_utils.uuid7()}.npz"  # no file of the client's has such a name
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
        errors.extend(limit_errors(services, preflight))
    if preflight and arrival.spec:
        errors.extend(spec_errors(arrival.spec, preflight, SPEC))
    if arrival.spec:
        errors.extend(await run_in_threadpool(callback_errors, arrival.spec, services, records, SPEC))
    if arrival.spec and sent.with_job and not form.keypoints:
        errors.extend(await run_in_threadpool(network_errors, arrival.spec, services, (SPEC,)))
    if errors or preflight is None or arrival.manifest is None or arrival.spec is None:
        raise unprocessable(errors)
    return CheckedSession(form, arrival.manifest, arrival.spec, preflight, record_path, arrival.upload_ids)


@contextlib.contextmanager
def stored(services: Services, checked: CheckedSession) -> Iterator[NewSession]:
    """Put the files of a session into the artifact store; the block records the session in the database.

    If the block fails, the files are removed; else the files of its uploads are. The reaper removes the files of a
    process that is killed in between.
    """
    session_id = services.store.sessions.reserve_id()
    sources = [(_KINDS.get(pointer.split("/")[1], pointer[1:]), file) for pointer, file in _files(checked.form).items()]
    files = tuple(_input_file(session_id, index, kind, file) for index, (kind, file) in enumerate(sources))
    with contextlib.ExitStack() as undo:
        undo.callback(services.artifacts.delete_prefix, session_prefix(session_id))
        for file, (_, source) in zip(files, sources, strict=True):
            services.artifacts.put_file(file.key, source.path)
        with checked.record_path.open("rb") as content:
            record_sha256 = hashlib.file_digest(content, "sha256").hexdigest()
        services.artifacts.put_file(record_key(session_id), checked.record_path)
        yield NewSession(
            id=session_id,
            name=checked.manifest.name,
            files=files,
            preflight=checked.preflight,
            upload_ids=checked.upload_ids,
            metadata=checked.manifest.metadata,
            record_sha256=record_sha256,
        )
        undo.pop_all()
    for upload_id in checked.upload_ids:
        services.uploads.remove(upload_id)


@contextlib.asynccontextmanager
async def _folder(spool_dir: Path) -> AsyncIterator[Path]:
    """Folder of the spool, removed at the end of the block."""
    folder = spool_dir / str(uuid_utils.uuid7())
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(shutil.rmtree, folder)


def _parsed(form: Form) -> Arrival:
    """Parse the JSON parts of a form."""
    manifest, manifest_errors = _document(form, MANIFEST, Manifest)
    spec, spec_problems = _document(form, SPEC, JobSpec)
    return Arrival(form, manifest, spec, (*manifest_errors, *spec_problems))


def _document(form: Form, part: str, model: type[_Model]) -> tuple[_Model | None, list[ErrorItem]]:
    """Parse a JSON part; a missing part has all defaults."""
    try:
        return model.model_validate_json(form.documents.get(part, b"{}")), []
    except ValidationError as error:
        return None, model_items(error.errors(), model, part)


def _parts_of(form: Form) -> object:
    """Content of a form as JSON, independent of its encoding."""
    files = {pointer: [file.name, file.sha256] for pointer, file in _files(form).items()}
    return files, {name: content.decode(errors="replace") for name, content in form.documents.items()}


async def _receive_names(request: Request, services: Services, documents: frozenset[str]) -> UploadedSession:
    body = await limited(request, services.settings.max_json_bytes).body()
    model = UploadedCapture if SPEC in documents else UploadedSession
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        if any(detail["type"] == "json_invalid" for detail in error.errors()):
            raise ApiError("malformed_json", "The body is not JSON.") from None
        raise unprocessable(model_items(error.errors(), model)) from None


def _adopt(services: Services, records: TenantRecords, folder: Path, sent: UploadedSession) -> Arrival:
    """Build the form from uploads, whose files stay on their spool."""
    parts = Parts(folder, services.limits, frozenset())
    named = [(VIDEOS, one) for one in sent.videos] + [(KEYPOINTS, one) for one in sent.keypoints]
    named += [(part, one) for part, one in ((CALIBRATION, sent.calibration), (TIMESTAMPS, sent.timestamps)) if one]
    for part, upload_id in named:
        try:
            upload = records.uploads.get(str(upload_id))
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
    """Files of a form by their pointers."""
    views = ((VIDEOS, form.videos), (KEYPOINTS, form.keypoints))
    files = {f"/{part}/{index}": file for part, several in views for index, file in enumerate(several)}
    for part, one in ((CALIBRATION, form.calibration), (TIMESTAMPS, form.timestamps)):
        if one is not None:
            files[f"/{part}"] = one
    return files


def _arguments(form: Form, manifest: Manifest, max_joints: int) -> list[str]:
    """Arguments of the preflight for a form."""
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
    """Add the pointer of a problem: to the entry of a camera in the manifest, or to the part of a file in the form.

    Problems of a file in an archive point to the archive. Of several entries of a camera, the last one is wrong.
    """
    of_camera = [index for index, one in enumerate(manifest.cameras) if one.name == item.camera]
    if of_camera and ("recording" in item.code or item.field in _OF_CAMERA):
        stated = manifest.cameras[of_camera[-1]].model_fields_set
        field = [item.field] if item.field in stated else []
        return item.model_copy(update={"pointer": pointer_to(MANIFEST, "cameras", of_camera[-1], *field)})
    pointers = {file.name: pointer for pointer, file in _files(form).items()}
    of_archive = {PurePosixPath(file.name).stem: pointers[file.name] for file in form.keypoints}
    file = item.file or ""
    pointer = pointers.get(file) or of_archive.get(file.split("/")[0])
    return item.model_copy(update={"pointer": pointer})


def _input_file(session_id: str, index: int, kind: str, file: ReceivedFile) -> InputFile:
    key = input_key(session_id, index, file.name)
    return InputFile(name=file.name, kind=kind, key=key, num_bytes=file.num_bytes, sha256=file.sha256)
