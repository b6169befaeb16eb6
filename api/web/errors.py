"""Errors of the web API, answered as ``application/problem+json`` (RFC 9457) by one handler.

Sentences of a problem are written here or by the code that raises it. They never contain the text of an exception, a
path or a stack trace. ``code`` is stable and documented. ``errors`` lists everything that is wrong with a request.
"""

from collections.abc import Iterator, Mapping, Sequence
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI
from pydantic import ConfigDict, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from api.web.contract.schemas import ID, DescribedModel
from pipeline.core.errors import Problem
from pipeline.core.problems import request_codes
from pipeline.core.problems.code_group import Code, read_sentences, usual_status
from worker.store import errors as store_errors
from worker.store.files.disk import is_disk_full
from worker.store.outages import Outage, find_outage

_log = structlog.get_logger(__name__)

_RETRY_AFTER_S = 5
_WAIT = "Send the request again after the time of Retry-After."
# Wait for a tenant at its quota of unfinished jobs, until one of them has probably ended.
_QUOTA_RETRY_AFTER_S = 30
# As many as a check of files reports, and some of the request itself.
MAX_LISTED = 80
_MAX_POINTER = 500

VIDEOS_DELETED_HINT = "Use the results of the capture's jobs; else send its videos again as a new capture."

_CODES: Mapping[int, Code] = {
    400: request_codes.MALFORMED_REQUEST,
    404: request_codes.NOT_FOUND,
    405: request_codes.METHOD_NOT_ALLOWED,
    408: request_codes.CLIENT_TOO_SLOW,
    413: request_codes.CONTENT_TOO_LARGE,
    415: request_codes.UNSUPPORTED_MEDIA_TYPE,
}
# Status of the upload protocol that HTTP does not define.
_TITLES: Mapping[int, str] = {460: "Checksum Mismatch"}
_DETAILS: Mapping[int, str] = {
    400: "The request can't be read.",
    404: "There is nothing at this address.",
    405: "This address does not accept the method.",
    408: "The body arrives too slowly. Send it again over a faster connection.",
    413: "The request is larger than the service accepts.",
    415: "This address does not accept the content type.",
}


_SENTENCES = read_sentences(request_codes)

MEANINGS: Mapping[str, str] = {code: _SENTENCES[code][0] for code in request_codes.FIELDS.places}
"""Meanings of the codes in ``errors[]`` that concern a field. The codes are part of the API and never change."""


class ErrorItem(DescribedModel):
    """Single problem of a request."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)

    code: Code = Field(
        description="Stable code, such as `video_truncated`; `/help/problems` lists all codes. Codes of fields and "
        "parameters: " + " ".join(f"`{code}`: {meaning}" for code, meaning in MEANINGS.items()),
        examples=["video_truncated"],
    )
    message: str = Field(examples=["The video ends in the middle of a frame."])
    """One sentence for a person."""
    pointer: str | None = Field(default=None, examples=["/videos/1"])
    """JSON pointer to the field, parameter or part of the form."""
    file: str | None = Field(default=None, description="Name of the file.", examples=["cam_1.mp4"])
    camera: str | None = Field(default=None, description="Name of the camera.", examples=["cam_1"])
    field: str | None = Field(default=None, description="Field of the file, such as `matrix`.")
    hint: str | None = Field(default=None, examples=["Copy it from the camera again."])
    """Advice to the caller."""


class MoreProblems(ErrorItem):
    """Entry that stands for problems that are not listed."""

    num_problems: int = Field(exclude=True, description="Number of the problems.")


class ProblemDetails(DescribedModel):
    """Body of an error response (RFC 9457)."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)

    type: str = Field(default="about:blank", description="Always `about:blank`; `code` names the problem.")
    title: str = Field(description="Name of the HTTP status.")
    status: int = Field(description="HTTP status.")
    detail: str = Field(description="Description of the problem, a sentence for a person.")
    instance: str = Field(description="Path of the request.", examples=[f"/v1/jobs/{ID}"])
    code: Code = Field(description="Stable name of the problem; `/help/problems` lists all codes.")
    errors: tuple[ErrorItem, ...] = Field(default=(), description="Everything that is wrong with the request.")
    camera: str | None = Field(default=None, description="Name of the camera, if the problem concerns one camera.")
    stage: str | None = Field(default=None, description="Name of the stage, if the problem concerns one stage.")
    hint: str | None = Field(default=None, description="Advice to the caller.")
    retryable: bool = Field(default=False, description="Whether the same request may succeed later.")
    request_id: str = Field(description="Id of the request, also in the service's log.", examples=[ID])


class ApiError(Exception):
    """Request that can't be served; the handler answers with a problem.

    Without a status it is the first one of the code.
    """

    def __init__(
        self,
        code: Code,
        detail: str,
        *,
        status: int | None = None,
        errors: Sequence[ErrorItem] = (),
        hint: str | None = None,
        retryable: bool = False,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = usual_status(code) if status is None else status
        self.code = code
        self.detail = detail
        self.errors = tuple(errors)
        self.hint = hint
        self.retryable = retryable
        self.headers = dict(headers or {})


def unprocessable(errors: Sequence[ErrorItem]) -> ApiError:
    """Error 422 for a request with wrong fields, parts or files."""
    num_problems = sum(error.num_problems if isinstance(error, MoreProblems) else 1 for error in errors)
    count = "One thing is" if num_problems == 1 else f"{num_problems} things are"
    return ApiError(
        request_codes.INVALID_REQUEST, f"{count} wrong with the request.", errors=_listed(errors, num_problems)
    )


def more_problems(num_problems: int) -> "MoreProblems":
    """Entry that stands for a number of problems that are not listed."""
    message = f"{num_problems:,} more problems are not listed."
    return MoreProblems(
        code=request_codes.MORE_PROBLEMS, message=message, hint="Correct these first.", num_problems=num_problems
    )


def _listed(errors: Sequence[ErrorItem], num_problems: int) -> list[ErrorItem]:
    """Limit the number of errors; the last entry says how many more there are."""
    each = [error for error in errors if not isinstance(error, MoreProblems)]
    shown = [_with_short_pointer(error) for error in each[:MAX_LISTED]]
    return [*shown, more_problems(more)] if (more := num_problems - len(shown)) else shown


def _with_short_pointer(error: ErrorItem) -> ErrorItem:
    """Shorten the pointer: the name of an unknown field may be as long as the request."""
    if error.pointer is None or len(error.pointer) <= _MAX_POINTER:
        return error
    return error.model_copy(update={"pointer": error.pointer[:_MAX_POINTER] + "..."})


def service_unavailable(code: Code, detail: str, errors: Sequence[ErrorItem] = (), hint: str | None = None) -> ApiError:
    """Error 503 while a part of the service does not respond."""
    headers = {"Retry-After": str(_RETRY_AFTER_S)}
    return ApiError(code, detail, errors=errors, hint=hint, retryable=True, headers=headers)


def database_damaged() -> ApiError:
    """Error 503 until the operator has replaced the database."""
    hint = "The service's log tells the operator what to do."
    return service_unavailable(request_codes.DATABASE_DAMAGED, "The database is damaged.", hint=hint)


def pointer_to(*steps: str | int) -> str:
    """JSON pointer (RFC 6901) from its steps.

    >>> pointer_to("spec", "a/b")
    '/spec/a~1b'
    """
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def error_item(problem: Problem, steps: tuple[str | int, ...] | None = ()) -> ErrorItem:
    """Entry of an answer for a problem; ``steps`` lead to its field's object in the body, ``None``: it is not there."""
    is_sent = steps is not None and problem.field is not None
    return ErrorItem(
        code=problem.code,
        message=problem.message,
        pointer=pointer_to(*(steps or ()), str(problem.field)) if is_sent else None,
        file=problem.file,
        camera=problem.camera,
        hint=problem.hint,
    )


def status_title(status: int) -> str:
    """Name of an HTTP status."""
    return _TITLES.get(status) or HTTPStatus(status).phrase


def problem_response(request: HTTPConnection, error: ApiError) -> Response:
    """Build the response from an error."""
    problem = ProblemDetails(
        title=status_title(error.status),
        status=error.status,
        detail=error.detail,
        instance=request.scope["path"],
        code=error.code,
        errors=error.errors,
        hint=error.hint,
        retryable=error.retryable,
        request_id=request.scope["state"]["request_id"],
    )
    return _ProblemResponse(problem.model_dump(mode="python"), error.status, error.headers)


def as_api_error(error: Exception) -> ApiError:
    """Translate an exception for the client; an unforeseen exception becomes a 500 without its text."""
    match error:
        case ApiError():
            return error
        case HTTPException():
            status = error.status_code
            code = _CODES.get(status, Code(HTTPStatus(status).name.lower()))
            detail = _DETAILS.get(status, HTTPStatus(status).phrase)
            return ApiError(code, detail, status=status, retryable=status == 408, headers=error.headers)
        case store_errors.DamagedArtifact():
            return ApiError(request_codes.ARTIFACT_DAMAGED, "A stored file is damaged.")
        case store_errors.DamagedDatabase():
            return database_damaged()
        case store_errors.JobStoreError():
            return _from_store(error)
        case _:
            return _from_failure(error)


def handle(request: Request, error: Exception) -> Response:
    """Answer any exception with a problem; log the failures of the service itself."""
    problem = as_api_error(error)
    if problem.status >= 500:
        if isinstance(error, store_errors.DamagedDatabase):
            _log.error("request_failed", code=problem.code, detail=str(error), instructions=error.instructions())
        else:
            _log.error("request_failed", code=problem.code, exc_info=error)
    if problem.status == 405:
        problem.headers["Allow"] = ", ".join(_methods_at(request))
    return problem_response(request, problem)


def install(app: FastAPI) -> None:
    """Register ``handle`` for the exceptions that routes raise deliberately.

    Unforeseen exceptions are caught by ``api.web.http.middleware.FailureResponse``.
    """
    for kind in (ApiError, HTTPException, store_errors.JobStoreError, ClientDisconnect):
        app.add_exception_handler(kind, handle)


def _methods_at(request: Request) -> Iterator[str]:
    """Methods that the address of a request accepts; the framework names the methods of one route only."""
    for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"):
        # `HeadByGet` answers HEAD wherever a route answers GET.
        methods = ("HEAD", "GET") if method == "HEAD" else (method,)
        scopes = [{**request.scope, "method": accepted} for accepted in methods]
        if any(route.matches(scope)[0] is Match.FULL for route in request.app.routes for scope in scopes):
            yield method


class _ProblemResponse(JSONResponse):
    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        # A client's JSON may contain lone surrogates. Pointers repeat them, and UTF-8 can't encode them.
        return super().render(_without_surrogates(content))


def _without_surrogates(value: Any) -> Any:
    match value:
        case str():
            return value.encode(errors="replace").decode()
        case dict():
            return {key: _without_surrogates(item) for key, item in value.items()}
        case list() | tuple():
            return [_without_surrogates(item) for item in value]
        case _:
            return value


def _from_store(error: store_errors.JobStoreError) -> ApiError:
    match error:
        case store_errors.NotFound():
            return ApiError(request_codes.NOT_FOUND, str(error))
        case store_errors.QuotaExceeded():
            return _from_quota(error)
        case store_errors.KeyReused():
            hint = "Use a new Idempotency-Key for each request; repeat a key only with the same request."
            return ApiError(request_codes.IDEMPOTENCY_KEY_REUSED, str(error), hint=hint)
        case store_errors.KeyBusy():
            headers = {"Retry-After": str(_RETRY_AFTER_S)}
            return ApiError(request_codes.IDEMPOTENCY_KEY_BUSY, str(error), retryable=True, headers=headers)
        case _:
            return _from_conflict(error)


def _from_conflict(error: store_errors.JobStoreError) -> ApiError:
    match error:
        case store_errors.NotFinished():
            hint = "Read the job again until its state is succeeded."
            return ApiError(request_codes.NOT_FINISHED, str(error), hint=hint, retryable=True)
        case store_errors.NoResults():
            reason = f"The job's error is {error.reason} " if error.reason else ""
            return ApiError(request_codes.NO_RESULTS, str(error), hint=reason + _advice_without_results(error))
        case store_errors.EditedMeanwhile():
            hint = "Read the edits again, then send them with their present ETag."
            return ApiError(request_codes.CHANGED_MEANWHILE, str(error), hint=hint)
        case store_errors.VideosDeleted():
            return ApiError(request_codes.VIDEOS_DELETED, str(error), hint=VIDEOS_DELETED_HINT)
        case _:
            return ApiError(request_codes.CONFLICT, str(error))


def _advice_without_results(error: store_errors.NoResults) -> str:
    if error.state == "expired":
        return "Start another job of its capture."
    return "Retry the job." if error.retryable else "Correct the input and send a new capture."


def _from_quota(error: store_errors.QuotaExceeded) -> ApiError:
    if error.name == "unfinished_jobs":
        hint = "Send the request again when a job has ended."
        headers = {"Retry-After": str(_QUOTA_RETRY_AFTER_S)}
        return ApiError(
            request_codes.QUOTA_EXCEEDED, str(error), status=429, hint=hint, retryable=True, headers=headers
        )
    return ApiError(request_codes.QUOTA_EXCEEDED, str(error), hint="Delete captures that are no longer needed.")


def _storage_full() -> ApiError:
    hint = "Delete captures that are no longer needed, or ask the operator for space; then send the request again."
    return ApiError(request_codes.STORAGE_FULL, "The service's disk is full.", hint=hint, retryable=True)


def _from_failure(error: Exception) -> ApiError:
    match error:
        case ClientDisconnect():
            return ApiError(request_codes.CLIENT_DISCONNECTED, "The client closed the connection.", retryable=True)
        case _ if is_disk_full(error):
            return _storage_full()
        case _ if find_outage(error) is Outage.DATABASE:
            return service_unavailable(request_codes.DATABASE_UNAVAILABLE, "The database does not respond.", hint=_WAIT)
        case _ if find_outage(error) is Outage.ARTIFACTS:
            return service_unavailable(
                request_codes.ARTIFACTS_UNAVAILABLE, "The artifact store does not respond.", hint=_WAIT
            )
        case store_errors.ArtifactsRefused():
            hint = "The operator checks MULTICAP_ARTIFACTS_URL, its bucket and its keys."
            return service_unavailable(
                request_codes.ARTIFACTS_REFUSED, "The artifact store refuses the service.", hint=hint
            )
        case _:
            return ApiError(request_codes.INTERNAL_ERROR, "The service failed; the log says why.", retryable=True)
