"""Webhooks about the ends of jobs, as the contract declares them; ``worker.run.webhooks`` sends them."""

from typing import Annotated, Any

from fastapi import APIRouter, Body, FastAPI
from starlette.routing import BaseRoute

from api.web.contract.description import Responses
from api.web.contract.examples import JOB_ID, SESSION_ID
from api.web.jobs.schemas import JobEnded

_ENDED = "Receive a job's end"
_GONE: Responses = {410: {"description": "The receiver is gone; the message is not sent again."}}
_EXAMPLE: dict[str, Any] = {
    "type": "job.succeeded",
    "timestamp": "2026-03-01T09:32:10.250000Z",
    "data": {"id": JOB_ID, "session_id": SESSION_ID, "state": "succeeded", "attempt": 1, "warnings": []},
}


def _job_ended(
    message: Annotated[JobEnded, Body(openapi_examples={"default": {"value": _EXAMPLE}})],
) -> None:
    """The service sends this message to the `callback_url` of the job's spec when the job has ended.

    It repeats the message for a day, until the receiver answers with 2xx or 410.
    """


def declare_webhooks(app: FastAPI) -> None:
    """Declare the webhooks that the service sends."""
    app.webhooks.post("job-ended", operation_id="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )


def job_ended_callbacks(operation_id: str, pointer: str) -> list[BaseRoute]:
    """Declare the webhook of an operation; ``pointer`` leads to the receiver's URL in the request's body."""
    router = APIRouter()
    address = f"{{$request.body#{pointer}}}"
    router.post(address, operation_id=operation_id, name="jobEnded", summary=_ENDED, status_code=204, responses=_GONE)(
        _job_ended
    )
    return router.routes
