"""Event stream of a job: its changes as server-sent events."""

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Response
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from api.web.auth import Caller, EventsViewDep, ViewerDep
from api.web.contract.description import Resource, problems
from api.web.dependencies import JobId, Services, ServicesDep
from api.web.events.changes import Watch
from api.web.jobs.schemas import JobOut
from worker.store.errors import NotFound
from worker.store.model.states import FINISHED

router = APIRouter(prefix="/v1/jobs/{job_id}", tags=["jobs"])

_RETRY_MS = 2000
_PING_S = 15
# Time after which a client that receives nothing is disconnected.
_SEND_TIMEOUT_S = 30.0
_EXAMPLE = "id: 17\nevent: job\ndata: {...}\nretry: 2000\n\n"
_STREAM: dict[str, Any] = {"text/event-stream": {"schema": {"type": "string"}, "example": _EXAMPLE}}


@router.get(
    "/events",
    summary="Follow a job",
    response_class=Response,
    responses={
        200: {"description": "A stream of server-sent events.", "content": _STREAM},
        204: {"description": "The job and its files are at rest, and the client has seen the last event."},
        **problems(404),
    },
)
async def stream_job_events(
    job_id: JobId,
    services: ServicesDep,
    records: EventsViewDep,
    caller: ViewerDep,
    last_event_id: Annotated[str | None, Header(description="Id of the last event that the client has seen.")] = None,
) -> Response:
    """Follow a job. An event `job` holds the whole job: at the start, after every change, and at the end.

    An event has an `id`, for `Last-Event-ID`, and as `data` the job in JSON, as `getJob` answers it. The stream ends
    with the job, after edits with the update of its files. A client that reconnects with `Last-Event-ID` gets one event
    with the current job as soon as it differs from the last event seen. An event `gone` reports that the job was
    deleted.
    """
    watch = services.changes.open(caller.owner, job_id)
    change = (await run_in_threadpool(records.jobs.changes, [job_id])).get(job_id)
    if change is None:
        raise NotFound("There is no such job.")
    seen_all = last_event_id == str(change.event)
    if seen_all and (await run_in_threadpool(records.jobs.get, job_id)).attempt_state in FINISHED:
        return Response(status_code=204)
    watch.last_change = change if seen_all else None
    events = _events(services, caller, watch)
    return EventSourceResponse(
        events, ping=_PING_S, send_timeout=_SEND_TIMEOUT_S, headers={"Cache-Control": "no-store"}
    )


async def _events(services: Services, caller: Caller, watch: Watch) -> AsyncIterator[ServerSentEvent]:
    async for update in services.changes.follow(watch):
        if update.job is None:
            yield ServerSentEvent(event="gone", data="{}")
        else:
            job = JobOut.from_job(update.job)
            document = (job.for_link() if caller.link else job).model_dump_json()
            yield ServerSentEvent(event="job", id=str(update.event), data=document, retry=_RETRY_MS)


RESOURCE = Resource(router=router)
