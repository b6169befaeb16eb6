"""Capture sessions: send, list, search, read, rename, delete."""

from typing import Annotated

from fastapi import APIRouter, Query, Response, status

from api.web.auth import JobViewDep, RecordsDep, ViewerDep
from api.web.contract.description import RETRY_AFTER, Resource, location, problems
from api.web.dependencies import Cursor, Limit, Services, ServicesDep, SessionId
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional, require_match
from api.web.http.idempotency import Answer, IdempotentRequest
from api.web.sessions.intake import check
from api.web.sessions.receiving import Creation, add_creation
from api.web.sessions.schemas import SESSION_FORM, SessionChanges, SessionOut, SessionPage
from api.web.sessions.storing import CheckedSession, stored
from api.web.uploads.intake import FETCH_RETRY_S
from worker.store.model.states import JobState
from worker.store.repositories.work.expiry import remove_files

router = APIRouter(prefix="/v1/sessions", tags=["sessions"])
# A route that takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1/sessions", tags=["sessions"], route_class=SmallBodyRoute)

Name = Annotated[
    str | None,
    Query(min_length=1, max_length=200, description="Only sessions whose names contain this text; case is ignored."),
]
State = Annotated[JobState | None, Query(description="Only sessions whose newest job is in this state.")]


def _add_session(services: Services, idempotent: IdempotentRequest, checked: CheckedSession) -> Answer:
    """Store the files of a session and record it."""
    with stored(services, checked) as new, idempotent.records.transaction() as work:
        new.add_to(work)
        body = SessionOut.from_capture(work.sessions.capture(new.id)).model_dump_json()
        headers = {"Location": f"/v1/sessions/{new.id}"}
        if new.arrival is None:
            return idempotent.store(work, Answer(201, headers, body))
        return idempotent.store(work, Answer(202, headers | {"Retry-After": str(FETCH_RETRY_S)}, body))


_CREATE = """\
Send a session: its videos, or what another program found in them, and the cameras' calibration.

As a form with the files, or as JSON that names finished uploads. Every file is checked. The answer says what was
found, or all that is wrong. Videos can be URLs: then the answer is 202, and the session tells its `state`. Generated
clients use `createSessionFromFiles` and `createSessionFromUploads`, which do the same with one kind of body each.
"""
add_creation(
    router,
    "",
    "createSession",
    Creation(SESSION_FORM, check, _add_session),
    "Send a session",
    _CREATE,
    status_code=status.HTTP_201_CREATED,
    response_model=SessionOut,
    responses={
        201: {"headers": {"Location": location("session")}},
        202: {
            "description": "Session whose videos are fetched.",
            "model": SessionOut,
            "headers": {"Location": location("session"), **RETRY_AFTER},
        },
        **problems(400, 408, 409, 413, 415, 422, 507),
    },
)


@router.get("", summary="List sessions", responses=problems(422))
def list_sessions(
    records: RecordsDep, name: Name = None, state: State = None, limit: Limit = 50, cursor: Cursor = None
) -> SessionPage:
    """List sessions, the newest first: all of them, or only sessions of a name or with a newest job in a state."""
    captures = records.sessions.page(limit=limit, after=str(cursor) if cursor else None, name=name, state=state)
    next_cursor = captures[-1].session.id if len(captures) == limit else None
    return SessionPage(sessions=tuple(map(SessionOut.from_capture, captures)), next_cursor=next_cursor)


@router.get(
    "/{session_id}",
    summary="Read a session",
    response_model=SessionOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_session(
    session_id: SessionId, records: JobViewDep, viewer: ViewerDep, if_none_match: IfNoneMatch = None
) -> Response:
    """Read a session: its files, what was found in them, and the number of its jobs with the newest one."""
    session = SessionOut.from_capture(records.sessions.capture(session_id))
    return conditional(session.for_link() if viewer.link else session, if_none_match)


@small.patch(
    "/{session_id}",
    summary="Rename a session",
    response_model=SessionOut,
    responses={200: {"headers": ETAG}, **problems(400, 404, 412, 413, 415, 422)},
)
def rename_session(
    session_id: SessionId, changes: SessionChanges, records: RecordsDep, if_match: IfMatch = None
) -> Response:
    """Rename a session; its jobs and the names of their downloads follow. With `If-Match`, only an unchanged one."""
    with records.transaction() as work:
        if if_match is not None:
            require_match(SessionOut.from_capture(work.sessions.locked(session_id)), if_match)
        capture = work.sessions.rename(session_id, changes.name)
    return conditional(SessionOut.from_capture(capture), None)


@router.delete(
    "/{session_id}", summary="Delete a session", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404, 409)
)
def delete_session(session_id: SessionId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a session with its videos, its jobs and their results. An unfinished job has to be canceled first."""
    # Its rows first, so that nothing is shown whose files are gone.
    services.disk.using_reserve(lambda: records.sessions.delete(session_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


CREATION = Resource(router=router, forms=(SESSION_FORM,))
RESOURCE = Resource(router=small)
