"""From a form to a session: receive, check, keep. All or nothing."""

import contextlib
import shutil
from collections.abc import AsyncIterator, Mapping
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
from api.errors import ErrorItem, unprocessable, validation_items
from api.form import CALIBRATION, KEYPOINTS, TIMESTAMPS, VIDEOS, Form, ReceivedFile
from api.multipart import announced_bytes, receive_form
from api.preflight import InvalidFilesError
from api.schemas import Manifest
from worker.jobs.artifacts import input_key, record_key, session_prefix
from worker.jobs.model import InputFile, Session
from worker.jobs.records import Records
from worker.jobs.spec import JobSpec

MANIFEST, SPEC = "manifest", "spec"

# What a file is called in a session where the form's part has another name.
_KINDS = {VIDEOS: "video", KEYPOINTS: KEYPOINTS}

_tracer = trace.get_tracer("multicap")

_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Intake:
    """A session that is in the store, and the reconstruction that was asked for with it."""

    session: Session
    spec: JobSpec


async def take_in(request: Request, services: Services, records: Records, documents: frozenset[str]) -> Intake:
    """Receive a form, check it with its files, and make it a session.

    Parameters
    ----------
    records
        Whose session it becomes.
    documents
        JSON parts that the form may have: ``manifest``, ``spec``.

    Raises
    ------
    ApiError
        If anything is wrong; then nothing is kept.
    """
    await run_in_threadpool(records.require_room, announced_bytes(request))
    async with _folder(services.settings.spool_dir) as folder:
        form = await receive_form(request, folder, services.limits, documents)
        manifest, manifest_errors = _document(form, MANIFEST, Manifest)
        spec, spec_errors = _document(form, SPEC, JobSpec)
        errors = [*form.errors, *manifest_errors, *spec_errors]
        preflight: Mapping[str, Any] = {}
        record = folder / f"{uuid_utils.uuid7()}.npz"  # no file of the client's has such a name
        if not form.errors:
            try:
                with _tracer.start_as_current_span("preflight"):
                    preflight = await anyio.to_thread.run_sync(
                        services.preflight.check,
                        _arguments(form, manifest or Manifest()),
                        record,
                        limiter=services.preflight_limiter,
                    )
            except InvalidFilesError as invalid:
                errors.extend(_located(item, form) for item in invalid.errors)
        if errors or manifest is None or spec is None:
            raise unprocessable(errors)
        session = await run_in_threadpool(_keep, services, records, form, manifest, preflight, record)
    return Intake(session, spec)


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


def _document(form: Form, part: str, model: type[_Model]) -> tuple[_Model | None, list[ErrorItem]]:
    """Parse a JSON part; without it, all is as by default."""
    try:
        return model.model_validate_json(form.documents.get(part, b"{}")), []
    except ValidationError as error:
        return None, list(validation_items(error.errors(), f"/{part}"))


def _files(form: Form) -> dict[str, ReceivedFile]:
    """All files of the form by their pointers."""
    views = ((VIDEOS, form.videos), (KEYPOINTS, form.keypoints))
    files = {f"/{part}/{index}": file for part, several in views for index, file in enumerate(several)}
    for part, one in ((CALIBRATION, form.calibration), (TIMESTAMPS, form.timestamps)):
        if one is not None:
            files[f"/{part}"] = one
    return files


def _arguments(form: Form, manifest: Manifest) -> list[str]:
    """What the check is told."""
    paths: dict[str, list[str]] = {}
    for pointer, file in _files(form).items():
        paths.setdefault(pointer.split("/")[1], []).append(str(file.path))
    arguments = [word for part, names in paths.items() for word in (f"--{part}", *names)]
    return arguments if manifest.frame_rate_hz is None else [*arguments, f"--frame-rate={manifest.frame_rate_hz!r}"]


def _located(item: ErrorItem, form: Form) -> ErrorItem:
    """Point from a problem with a file, or with what is in an archive, to the file's part of the form."""
    pointers = {file.name: pointer for pointer, file in _files(form).items()}
    of_archive = {PurePosixPath(file.name).stem: pointers[file.name] for file in form.keypoints}
    file = item.file or ""
    pointer = pointers.get(file) or of_archive.get(file.split("/")[0])
    return item.model_copy(update={"pointer": pointer})


def _keep(
    services: Services, records: Records, form: Form, manifest: Manifest, preflight: Mapping[str, Any], record: Path
) -> Session:
    """Move the files to the artifact store, then say so in the database; neither without the other.

    Whoever is killed in between has announced them, so that they go.
    """
    session_id = services.store.announce_session()
    received = [(_KINDS.get(pointer.split("/")[1], pointer[1:]), file) for pointer, file in _files(form).items()]
    files = [_input_file(session_id, index, kind, file) for index, (kind, file) in enumerate(received)]
    with contextlib.ExitStack() as undo:
        undo.callback(services.artifacts.delete_prefix, session_prefix(session_id))
        for file, (_, source) in zip(files, received, strict=True):
            services.artifacts.put_file(file.key, source.path)
        services.artifacts.put_file(record_key(session_id), record)
        session = records.create_session(manifest.name, files, preflight, session_id)
        undo.pop_all()
    return session


def _input_file(session_id: str, index: int, kind: str, file: ReceivedFile) -> InputFile:
    key = input_key(session_id, index, file.name)
    return InputFile(name=file.name, kind=kind, key=key, num_bytes=file.num_bytes, sha256=file.sha256)
