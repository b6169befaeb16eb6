"""From a form to a session: receive, check, keep. All or nothing."""

import contextlib
import shutil
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import anyio
import uuid_utils
from fastapi import Request
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool

from api.dependencies import Services
from api.errors import ErrorItem, unprocessable, validation_items
from api.form import Form, ReceivedFile
from api.multipart import receive_form
from api.preflight import InvalidFilesError
from api.schemas import Manifest
from worker.jobs.artifacts import input_key, record_key
from worker.jobs.model import InputFile, Session
from worker.jobs.spec import JobSpec

MANIFEST, SPEC = "manifest", "spec"

_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class Intake:
    """A session that is in the store, and the reconstruction that was asked for with it."""

    session: Session
    spec: JobSpec


async def take_in(request: Request, services: Services, documents: frozenset[str]) -> Intake:
    """Receive a form, check it with its files, and make it a session.

    Parameters
    ----------
    documents
        JSON parts that the form may have: ``manifest``, ``spec``.

    Raises
    ------
    ApiError
        If anything is wrong; then nothing is kept.
    """
    async with _folder(services.settings.spool_dir) as folder:
        form = await receive_form(request, folder, services.limits, documents)
        manifest, manifest_errors = _document(form, MANIFEST, Manifest)
        spec, spec_errors = _document(form, SPEC, JobSpec)
        errors = [*form.errors, *manifest_errors, *spec_errors]
        preflight: Mapping[str, Any] = {}
        record = folder / f"{uuid_utils.uuid7()}.npz"  # no file of the client's has such a name
        if form.calibration and form.videos and not form.errors:
            try:
                preflight = await anyio.to_thread.run_sync(
                    services.preflight.check,
                    [video.path for video in form.videos],
                    form.calibration.path,
                    record,
                    limiter=services.preflight_limiter,
                )
            except InvalidFilesError as invalid:
                errors.extend(_located(item, form) for item in invalid.errors)
        if errors or manifest is None or spec is None:
            raise unprocessable(errors)
        session = await run_in_threadpool(_keep, services, form, manifest, preflight, record)
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


def _located(item: ErrorItem, form: Form) -> ErrorItem:
    """Point from a problem with a file to the file's part of the form."""
    pointers = {video.name: f"/videos/{index}" for index, video in enumerate(form.videos)}
    if form.calibration:
        pointers[form.calibration.name] = "/calibration"
    return item.model_copy(update={"pointer": pointers.get(item.file or "")})


def _keep(services: Services, form: Form, manifest: Manifest, preflight: Mapping[str, Any], record: Path) -> Session:
    """Move the files to the artifact store, then say so in the database; neither without the other."""
    session_id = str(uuid_utils.uuid7())
    received = [("video", video) for video in form.videos]
    if form.calibration:
        received.append(("calibration", form.calibration))
    files = [_input_file(session_id, index, kind, file) for index, (kind, file) in enumerate(received)]
    with contextlib.ExitStack() as undo:
        undo.callback(services.artifacts.delete_prefix, f"sessions/{session_id}/")
        for file, (_, source) in zip(files, received, strict=True):
            services.artifacts.put_file(file.key, source.path)
        services.artifacts.put_file(record_key(session_id), record)
        session = services.store.create_session(manifest.name, files, preflight, session_id)
        undo.pop_all()
    return session


def _input_file(session_id: str, index: int, kind: str, file: ReceivedFile) -> InputFile:
    key = input_key(session_id, index, file.name)
    return InputFile(name=file.name, kind=kind, key=key, num_bytes=file.num_bytes, sha256=file.sha256)
