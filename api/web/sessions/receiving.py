"""Records that clients send, as a form with files or as JSON that names uploads: how they arrive, and their routes."""

import contextlib
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import anyio
import uuid_utils
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.routing import BaseRoute

from api.web.contract.description import request_body
from api.web.dependencies import Services, ServicesDep
from api.web.errors import ApiError, ErrorItem, unprocessable
from api.web.http.bodies import form_kinds
from api.web.http.bodies.form import Form, Parts
from api.web.http.bodies.multipart import receive_form
from api.web.http.bodies.reading import announced_bytes, limited
from api.web.http.bodies.validation import FieldPlaces, model_items
from api.web.http.idempotency import Answer, IdempotentRequest, IdempotentRequestDep
from api.web.sessions.schemas import UploadedSession
from api.web.uploads.intake import source_fault, source_name, unfinished
from pipeline.core.problems import request_codes
from worker.store.errors import NotFound
from worker.store.tenant_records import TenantRecords

_Model = TypeVar("_Model", bound=BaseModel)
# Parts of a form for the kinds of files that are the footage of a session.
_FOOTAGE = {
    "video": form_kinds.VIDEOS,
    form_kinds.KEYPOINTS: form_kinds.KEYPOINTS,
    form_kinds.TIMESTAMPS: form_kinds.TIMESTAMPS,
    form_kinds.LABORATORY: form_kinds.LABORATORY,
    form_kinds.OWN_POINTS: form_kinds.OWN_POINTS,
}
_BESIDE = (form_kinds.LABORATORY, form_kinds.OWN_POINTS)


@dataclass(frozen=True, slots=True)
class Sent:
    """A session, a calibration or a character as a client sent it, in a folder of the spool."""

    folder: Path  # Holds the files of a form; removed at the end of the request
    kind: form_kinds.FormKind  # Kind of the form, or of the JSON in its place
    content: Form | form_kinds.UploadedFiles
    parts: object  # JSON of the content, for the fingerprint of the request
    places: FieldPlaces  # Places of the fields of the body, for hints

    @property
    def upload_ids(self) -> tuple[str, ...]:
        """Ids of the uploads that it names; none of a form."""
        return () if isinstance(self.content, Form) else self.content.upload_ids()


@contextlib.asynccontextmanager
async def received(
    request: Request,
    services: Services,
    idempotent: IdempotentRequest,
    kind: form_kinds.FormKind,
    types: Collection[str],
) -> AsyncIterator[Sent]:
    """Receive a record as a form, or as JSON that names uploads; its files are there in the block.

    ``types`` are the content types that the operation takes: ``FORM_TYPE``, ``JSON_TYPE`` or both. Raises ``ApiError``
    if there is no room for it, or the request can't be read.
    """
    content_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if content_type not in types:
        raise _unsupported(types)
    names_uploads = content_type == form_kinds.JSON_TYPE
    places = FieldPlaces.declared_for(request, content_type)
    to_come = 0 if names_uploads else announced_bytes(request)
    # A request that comes again may need no more room than there is.
    is_answered = await run_in_threadpool(idempotent.is_answered)
    if not is_answered:
        services.checks.require_room(request.state.caller.owner)
        await run_in_threadpool(idempotent.records.require_room, to_come, unfinished_jobs=int(kind.has_job))
    async with spool_folder(services.settings.spool_dir) as folder:
        if names_uploads:
            if not is_answered:
                services.disk.require_room()
            names = await _receive_names(request, services, kind.uploaded, places)
            yield Sent(folder, kind, names, names.model_dump(mode="json"), places)
        else:
            form = await receive_form(request, folder, services.limits, services.disk, kind, places)
            yield Sent(folder, kind, form, _fingerprint_parts(form), places)


def _unsupported(types: Collection[str]) -> ApiError:
    """Error 415 that names the content types of an operation."""
    ways = {
        form_kinds.FORM_TYPE: f"Files are sent as {form_kinds.FORM_TYPE}",
        form_kinds.JSON_TYPE: f"Uploads are named by {form_kinds.JSON_TYPE}",
    }
    return ApiError(request_codes.UNSUPPORTED_MEDIA_TYPE, f"{'. '.join(ways[content_type] for content_type in types)}.")


@contextlib.asynccontextmanager
async def spool_folder(spool_dir: Path) -> AsyncIterator[Path]:
    """Folder of the spool, removed at the end of the block."""
    folder = spool_dir / str(uuid_utils.uuid7())
    folder.mkdir(parents=True)
    try:
        yield folder
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(shutil.rmtree, folder)


def sent_form(sent: Sent) -> Form:
    """Form that a client sent."""
    if not isinstance(sent.content, Form):
        raise TypeError("uploads are named")
    return sent.content


def document(sent: Sent, part: str, model: type[_Model]) -> tuple[_Model | None, list[ErrorItem]]:
    """Parse a JSON part of a form; a missing part has all defaults."""
    try:
        return model.model_validate_json(sent_form(sent).documents.get(part, b"{}")), []
    except ValidationError as error:
        return None, model_items(error, model, sent.places, part)


async def with_spec(
    owner: str, services: Services, records: TenantRecords, sent: Sent, model: type[_Model]
) -> tuple[Form, _Model | None, str, list[ErrorItem]]:
    """Form of what was sent with its choices, the part that leads to these in the request, and everything wrong.

    JSON that names uploads has the fields of the choices itself.
    """
    if isinstance(sent.content, Form):
        spec, problems = document(sent, form_kinds.SPEC, model)
        return sent.content, spec, form_kinds.SPEC, [*sent.content.errors, *problems]
    if not isinstance(sent.content, model):
        raise TypeError("the uploads have other choices")
    # Large files are read once, for their digests, in the turn of the checks.
    form = await services.checks.run(owner, adopted, services, records, sent, sent.content)
    return form, sent.content, "", [*form.errors]


def _fingerprint_parts(form: Form) -> object:
    """Content of a form as JSON, independent of its encoding."""
    files = {pointer: [file.name, file.sha256] for pointer, file in form.pointers().items()}
    return files, {name: content.decode(errors="replace") for name, content in form.documents.items()}


async def _receive_names(
    request: Request, services: Services, model: type[form_kinds.UploadedFiles], places: FieldPlaces
) -> form_kinds.UploadedFiles:
    body = await limited(request, services.settings.max_json_bytes).body()
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        items = model_items(error, model, places)
        if any(item.code == request_codes.MALFORMED_JSON for item in items):
            raise ApiError(request_codes.MALFORMED_JSON, "The body is not JSON.") from None
        raise unprocessable(items) from None


def adopted(services: Services, records: TenantRecords, sent: Sent, names: form_kinds.UploadedFiles) -> Form:
    """Build the form from uploads, whose files stay on their spool; empty files stand for files that are fetched."""
    parts = Parts(sent.folder, services.limits, sent.kind, sent.places)
    for part, named in names.uploads():
        if isinstance(named, str):
            _announce(services, parts, part, named, sent.folder)
            continue
        try:
            upload = records.uploads.get(str(named))
            num_bytes = services.uploads.offset(upload)
        except NotFound:
            message = "There is no such upload."
            parts.lack(
                part,
                request_codes.UPLOAD_UNKNOWN,
                message,
                "It may have been used, or its time is over: send it again.",
            )
            continue
        except ApiError as error:  # its bytes are elsewhere
            parts.lack(part, error.code, error.detail, str(error.hint), upload.name)
            continue
        if (problem := upload.problem) is not None:
            parts.lack(
                part, problem.code, problem.detail, problem.hint or "Send another link, or the file.", upload.name
            )
        elif upload.is_fetching or num_bytes < upload.num_bytes:
            hint = "Wait until it is fetched." if upload.is_fetching else "Send the rest of it first."
            parts.lack(part, request_codes.UPLOAD_UNFINISHED, unfinished(upload, num_bytes), hint, upload.name)
        else:
            parts.adopt(part, upload.name, services.uploads.file(upload))
    if (source_id := names.source_id()) is not None:
        _copy_footage(services, records, source_id, parts)
    return parts.form(names.named(), _num_stated_parts(records, names))


def _announce(services: Services, parts: Parts, part: str, url: str, folder: Path) -> None:
    """Add an empty file to a form for one that is fetched, so that names and numbers of files are checked before."""
    if (fault := source_fault(services, url)) is not None:
        parts.lack(part, *fault)
        return
    empty = folder / str(uuid_utils.uuid7())
    empty.touch()
    parts.adopt(part, source_name(url), empty)


def _num_stated_parts(records: TenantRecords, names: form_kinds.UploadedFiles) -> int:
    """Number of videos that are stated as further parts of recordings, or were so in the session that is copied."""
    cameras = names.manifest.cameras if isinstance(names, UploadedSession) else ()
    stated = [*(camera.more_files for camera in cameras)]
    if (source_id := names.source_id()) is not None:
        with contextlib.suppress(NotFound):  # the form says so
            stated += [recording.more_files for recording in records.sessions.get(source_id).preflight.recordings]
    return sum(map(len, stated))


def _copy_footage(services: Services, records: TenantRecords, session_id: str, parts: Parts) -> None:
    """Copy the videos or keypoints of a stored session to the parts of a form.

    Copies, so that each session has files of its own: either may be deleted.
    """
    if any(parts.has(part) for part in _FOOTAGE.values() if part not in _BESIDE):
        message = "The footage comes from a capture: files of footage can't be sent too."
        parts.reject_field(
            form_kinds.SESSION_ID, request_codes.PART_NOT_ALLOWED, message, "Omit session_id, or the files."
        )
        return
    try:
        session = records.sessions.get(session_id)
        if session.videos_deleted_at is not None:
            message = "The videos of this capture were deleted, and can't be copied."
            parts.reject_field(form_kinds.SESSION_ID, request_codes.VIDEOS_DELETED, message, "Send the videos.")
            return
        files = session.files
        for file in files:
            # These files may be sent later, or again.
            if (part := _FOOTAGE.get(file.kind)) is None or (part in _BESIDE and parts.has(part)):
                continue
            services.disk.require_room(file.num_bytes)
            with services.artifacts.open(file.key, file.sha256) as source:
                parts.copy(part, file.name, source)
    except NotFound:
        parts.reject_field(
            form_kinds.SESSION_ID,
            request_codes.SESSION_UNKNOWN,
            "There is no such session.",
            "GET /v1/sessions lists them.",
        )


_Checked = TypeVar("_Checked")
# Nouns in the ids of operations, by the bodies that they take.
_WAYS = (
    ("", form_kinds.EITHER_TYPE, ""),
    ("Files", (form_kinds.FORM_TYPE,), "Takes a form with the files alone"),
    ("Uploads", (form_kinds.JSON_TYPE,), "Takes JSON alone that names finished uploads"),
)


@dataclass(frozen=True, slots=True)
class Creation(Generic[_Checked]):
    """How records are created."""

    form: form_kinds.FormKind  # Kind of the form, or of the JSON in its place
    # Checks what an owner sent; raises ``ApiError`` with all that is wrong
    check: Callable[[str, Services, TenantRecords, Sent], Awaitable[_Checked]]
    add: Callable[[Services, IdempotentRequest, _Checked], Answer]  # Stores the files and the record, both or neither

    async def respond(
        self, request: Request, services: Services, idempotent: IdempotentRequest, types: Collection[str]
    ) -> Response:
        """Receive a body of one of the content types, check it and add the record; once for each idempotency key."""
        async with received(request, services, idempotent, self.form, types) as sent:
            if (earlier := await run_in_threadpool(idempotent.begin, sent.parts)) is not None:
                return earlier
            async with idempotent.held():
                checked = await self.check(request.state.caller.owner, services, idempotent.records, sent)
                answer = await run_in_threadpool(self.add, services, idempotent, checked)
        return answer.response()


def add_creation(
    router: APIRouter,
    path: str,
    operation_id: str,
    creation: Creation[Any],
    summary: str,
    description: str,
    callbacks: Callable[[str], list[BaseRoute]] = lambda _: [],
    **declared: Any,
) -> None:
    """Add an operation that takes a form with files or JSON that names uploads, and routes for one of these alone.

    Generators of clients need one kind of body for each operation.

    ``callbacks``: webhooks of a route, by what is sent: nothing, ``Files`` or ``Uploads``. ``declared``: what all three
    declare, as arguments of FastAPI's ``add_api_route``.
    """

    def endpoint(types: Collection[str]) -> Callable[..., Awaitable[Response]]:
        async def create(request: Request, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
            return await creation.respond(request, services, idempotent, types)

        return create

    for sent, types, difference in _WAYS:
        router.add_api_route(
            f"{path}/from-{sent.lower()}" if sent else path,
            endpoint(types),
            methods=["POST"],
            operation_id=f"{operation_id}From{sent}" if sent else operation_id,
            summary=f"{summary} from {sent.lower()}" if sent else summary,
            description=f"{difference}; otherwise as `{operation_id}`." if sent else description,
            callbacks=callbacks(sent),
            openapi_extra=request_body(creation.form, types),
            **declared,
        )
