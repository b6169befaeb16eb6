"""Capture sessions: send, list, search, read, rename, delete."""

from collections.abc import Collection
from typing import Annotated, Any

from fastapi import APIRouter, Body, Query, Request, Response, status
from starlette.concurrency import run_in_threadpool

from api.auth import JobViewDep, RecordsDep, ViewerDep
from api.contract.bodies import body_of
from api.contract.description import answer, location, problems
from api.contract.examples import SESSION_ID
from api.contract.resource import Resource
from api.dependencies import Cursor, Limit, Services, ServicesDep, SessionId
from api.http.bodies.form_kinds import EITHER_TYPE, FORM_TYPE, JSON_TYPE
from api.http.bodies.reading import SmallBodyRoute
from api.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional, require_match
from api.http.idempotency import Answer, IdempotentRequest, IdempotentRequestDep
from api.sessions import examples
from api.sessions.form import SESSION_FORM
from api.sessions.intake import CheckedSession, check, stored
from api.sessions.receiving import received
from api.sessions.schemas import SessionChanges, SessionOut, SessionPage
from worker.jobs.files.removals import remove_files
from worker.jobs.model.sessions import Capture
from worker.jobs.model.states import JobState

router = APIRouter(prefix="/v1/sessions", tags=["sessions"])
# A route that takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1/sessions", tags=["sessions"], route_class=SmallBodyRoute)

_ONE = answer("Session")
Name = Annotated[
    str | None,
    Query(min_length=1, max_length=200, description="Only sessions whose names contain this text; case is ignored."),
]
State = Annotated[JobState | None, Query(description="Only sessions whose newest job is in this state.")]
_LOCATION = {"headers": {"Location": location("session", f"/v1/sessions/{SESSION_ID}")}}


def _creates_session(types: Collection[str]) -> dict[str, Any]:
    """Declare an operation that creates a session."""
    return {
        "status_code": status.HTTP_201_CREATED,
        "response_model": SessionOut,
        "responses": {201: _ONE | _LOCATION, **problems(400, 408, 409, 413, 415, 422, 507)},
        "openapi_extra": body_of(SESSION_FORM, types),
    }


@router.post("", operation_id="createSession", summary="Send a session", **_creates_session(EITHER_TYPE))
async def create_session(request: Request, services: ServicesDep, idempotent: IdempotentRequestDep) -> Response:
    """Send a session: its videos, or what another program found in them, and the cameras' calibration.

    As a form with the files, or as JSON that names finished uploads. Every file is checked. The answer says what was
    found, or all that is wrong. Generated clients use `createSessionFromFiles` and `createSessionFromUploads`, which do
    the same with one kind of body each.
    """
    return await _create_session(request, services, idempotent, EITHER_TYPE)


@router.post(
    "/from-files",
    operation_id="createSessionFromFiles",
    summary="Send a session's files",
    **_creates_session({FORM_TYPE}),
)
async def create_session_from_files(
    request: Request, services: ServicesDep, idempotent: IdempotentRequestDep
) -> Response:
    """Send a session as a form with its files; otherwise as `createSession`."""
    return await _create_session(request, services, idempotent, {FORM_TYPE})


@router.post(
    "/from-uploads",
    operation_id="createSessionFromUploads",
    summary="Send a session's uploads",
    **_creates_session({JSON_TYPE}),
)
async def create_session_from_uploads(
    request: Request, services: ServicesDep, idempotent: IdempotentRequestDep
) -> Response:
    """Send a session as JSON that names finished uploads; otherwise as `createSession`."""
    return await _create_session(request, services, idempotent, {JSON_TYPE})


async def _create_session(
    request: Request, services: Services, idempotent: IdempotentRequest, types: Collection[str]
) -> Response:
    async with received(request, services, idempotent, SESSION_FORM, types) as sent:
        if (earlier := await run_in_threadpool(idempotent.begin, sent.parts)) is not None:
            return earlier
        async with idempotent.held():
            checked = await check(request, services, idempotent.records, sent)
            answer = await run_in_threadpool(_add_session, services, idempotent, checked)
    return answer.response()


def _add_session(services: Services, idempotent: IdempotentRequest, checked: CheckedSession) -> Answer:
    """Store the files of a session and record it."""
    with stored(services, checked) as new, idempotent.records.transaction() as work:
        work.uploads.use(new.upload_ids)
        session = work.sessions.add(new.name, new.files, new.preflight, new.id, new.metadata, new.record_sha256)
        return idempotent.store(work, _created(Capture(session)))


@router.get(
    "", operation_id="listSessions", summary="List sessions", responses={200: answer("SessionPage"), **problems(422)}
)
def list_sessions(
    records: RecordsDep, name: Name = None, state: State = None, limit: Limit = 50, cursor: Cursor = None
) -> SessionPage:
    """List sessions, the newest first: all of them, or those of a name or with a newest job in a state."""
    captures = records.sessions.page(limit=limit, after=str(cursor) if cursor else None, name=name, state=state)
    next_cursor = captures[-1].session.id if len(captures) == limit else None
    return SessionPage(sessions=tuple(map(SessionOut.of, captures)), next_cursor=next_cursor)


@router.get(
    "/{session_id}",
    operation_id="getSession",
    summary="Read a session",
    response_model=SessionOut,
    responses={200: _ONE | {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_session(
    session_id: SessionId, records: JobViewDep, viewer: ViewerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Read a session: its files, what was found in them, and the number of its jobs with the newest one."""
    session = SessionOut.of(records.sessions.capture(session_id))
    return conditional(session.for_link() if viewer.link else session, if_none_match)


@small.patch(
    "/{session_id}",
    operation_id="renameSession",
    summary="Rename a session",
    response_model=SessionOut,
    responses={200: _ONE | {"headers": ETAG}, **problems(400, 404, 412, 413, 415, 422)},
)
def rename_session(
    session_id: SessionId,
    changes: Annotated[SessionChanges, Body(openapi_examples={"default": {"value": examples.CHANGES}})],
    records: RecordsDep,
    if_match: IfMatch = None,
) -> Response:
    """Rename a session; its jobs and the names of their downloads follow. With `If-Match`, only an unchanged one."""
    with records.transaction() as work:
        if if_match is not None:
            require_match(SessionOut.of(work.sessions.locked(session_id)), if_match)
        capture = work.sessions.rename(session_id, changes.name)
    return conditional(SessionOut.of(capture), None)


@router.delete(
    "/{session_id}",
    operation_id="deleteSession",
    summary="Delete a session",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(404, 409),
)
def delete_session(session_id: SessionId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a session with its videos, its jobs and their results. An unfinished job has to be canceled first."""
    # Its rows first, so that nothing is shown whose files are gone.
    services.disk.using_reserve(lambda: records.sessions.delete(session_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


def _created(capture: Capture) -> Answer:
    headers = {"Location": f"/v1/sessions/{capture.session.id}"}
    return Answer(201, headers, SessionOut.of(capture).model_dump_json())


CREATION = Resource(router=router, forms=(SESSION_FORM,))
RESOURCE = Resource(router=small, answers=examples.ANSWERS, parameters={"session_id": SESSION_ID})
