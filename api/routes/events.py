"""Events: a job's changes as they happen."""

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Response
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from api.auth import AnyCallerDep, RecordsDep
from api.contract.description import problems
from api.contract.examples import EVENT
from api.dependencies import JobId, Services, ServicesDep
from api.schemas import JobOut
from worker.jobs.errors import NotFound
from worker.jobs.model import FINISHED, Change

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["jobs"])

_RETRY_MS = 2000
_PING_S = 15
# A client that takes nothing for so long is cut off.
_SEND_TIMEOUT_S = 30.0
_EVENT = {
    "description": "One event of the stream, by its fields.",
    "type": "object",
    "properties": {
        "id": {"type": "string", "description": "For `Last-Event-ID`."},
        "event": {"enum": ["job", "gone"]},
        "data": {
            "type": "string",
            "contentMediaType": "application/json",
            "contentSchema": {"$ref": "#/components/schemas/JobOut"},
        },
        "retry": {"type": "integer", "description": "Milliseconds until it is worth coming back."},
    },
    "required": ["event", "data"],
}
_STREAM: dict[str, Any] = {"text/event-stream": {"schema": _EVENT, "example": EVENT}}


@router.get(
    "/events",
    operation_id="streamJobEvents",
    summary="Follow a job",
    response_class=Response,
    responses={
        200: {"description": "A stream of server-sent events.", "content": _STREAM},
        204: {"description": "The job has ended, and the client knows it: there will be no more."},
        **problems(404),
    },
)
async def stream_job_events(
    job_id: JobId,
    services: ServicesDep,
    records: RecordsDep,
    caller: AnyCallerDep,
    last_event_id: Annotated[str | None, Header(description="The last event that the client has seen.")] = None,
) -> Response:
    """Follow a job: an event `job` with the job as it is, at first, whenever it changes, and when it ends.

    The stream ends with the job. Events that go by while a client is away are not lost, but told as one: with
    `Last-Event-ID` a client hears of the job again as soon as there is more than it has seen. An event `gone` says that
    the job was deleted.
    """
    owner = caller.owner
    services.changes.require_room(owner)
    change = (await run_in_threadpool(records.jobs.changes, [job_id])).get(job_id)
    if change is None:
        raise NotFound("There is no such job.")
    seen_all = last_event_id == str(change.event)
    if seen_all and (await run_in_threadpool(records.jobs.get, job_id)).state in FINISHED:
        return Response(status_code=204)
    events = _events(services, owner, job_id, change if seen_all else None)
    return EventSourceResponse(
        events, ping=_PING_S, send_timeout=_SEND_TIMEOUT_S, headers={"Cache-Control": "no-store"}
    )


async def _events(services: Services, owner: str, job_id: str, known: Change | None) -> AsyncIterator[ServerSentEvent]:
    async for news in services.changes.follow(owner, job_id, known):
        if news.job is None:
            yield ServerSentEvent(event="gone", data="{}")
        else:
            document = JobOut.of(news.job).model_dump_json()
            yield ServerSentEvent(event="job", id=str(news.event), data=document, retry=_RETRY_MS)
