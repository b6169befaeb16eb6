"""What went wrong, as ``application/problem+json`` (RFC 9457): one shape, one handler.

A problem's words are written here or by the code that found it: never an exception's text, a path or a stack. ``code``
is stable and documented; ``errors`` holds everything that is wrong with a request, never the first thing only.
"""

from collections.abc import Iterator, Mapping, Sequence
from http import HTTPStatus
from typing import Any

import structlog
from fastapi import FastAPI
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Match

from api.contract.problem_codes import FIELDS, STATUSES
from worker.jobs.errors import (
    ArtifactsUnavailable,
    DamagedArtifact,
    DamagedDatabase,
    JobStoreError,
    KeyBusy,
    KeyReused,
    NoResults,
    NotFinished,
    NotFound,
    QuotaExceeded,
)
from worker.jobs.files.disk import is_disk_full

_log = structlog.get_logger(__name__)

_RETRY_AFTER_S = 5
# Until a job of a tenant that has as many as it may have is likely to have ended.
_QUOTA_RETRY_AFTER_S = 30
# As many as a check of files gives, and some of the request itself.
_MAX_LISTED = 80
_MAX_POINTER = 500

_CODES: Mapping[int, str] = {
    400: "malformed_request",
    404: "not_found",
    405: "method_not_allowed",
    408: "client_too_slow",
    413: "content_too_large",
    415: "unsupported_media_type",
}
# Of the upload protocol; HTTP knows no such status.
_TITLES: Mapping[int, str] = {460: "Checksum Mismatch"}
_DETAILS: Mapping[int, str] = {
    400: "The request can't be read.",
    404: "There is nothing at this address.",
    405: "This address does not take that method.",
    408: "The body comes too slowly. Send it again over a better line.",
    413: "The request is larger than the service takes.",
    415: "The service does not take this type of content here.",
}


MEANINGS: Mapping[str, str] = {one.name: one.meaning for one in FIELDS.codes}
"""Codes of ``errors[]`` that are about a field, with their meanings: part of the API, so they stay."""


class ErrorItem(BaseModel):
    """One thing that is wrong with a request."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)

    code: str = Field(
        description="Stable, such as `video_truncated`; docs/problems.md lists all codes. Of fields and parameters: "
        + " ".join(f"`{code}`: {meaning}" for code, meaning in MEANINGS.items())
    )
    message: str = Field(description="One sentence for a person.")
    pointer: str | None = Field(default=None, description="JSON pointer to the field, parameter or part of the form.")
    file: str | None = Field(default=None, description="Name of the file.")
    camera: str | None = Field(default=None, description="Name of the camera.")
    field: str | None = Field(default=None, description="Field of the file, such as `matrix`.")
    hint: str | None = Field(default=None, description="What to do.")


class ProblemDetails(BaseModel):
    """A problem, by RFC 9457."""

    model_config = ConfigDict(json_schema_serialization_defaults_required=True)

    type: str = Field(default="about:blank", description="`about:blank`: `code` says which problem it is.")
    title: str = Field(description="The status in words.")
    status: int
    detail: str = Field(description="What happened, in a sentence for a person.")
    instance: str = Field(description="What was asked for.")
    code: str = Field(description="Stable name of the problem.")
    errors: tuple[ErrorItem, ...] = Field(default=(), description="All that is wrong with the request.")
    camera: str | None = None
    stage: str | None = None
    hint: str | None = None
    retryable: bool = Field(default=False, description="Whether the same request may succeed later.")
    request_id: str = Field(description="Stands in the service's log too.")


class ApiError(Exception):
    """A request that can't be served; becomes a problem.

    Parameters
    ----------
    code, detail
        Of the problem.
    status
        Status of the answer; ``None``: the first one of the code in ``api.contract.problem_codes``.
    errors
        All that is wrong with the request.
    headers
        Headers of the answer, beside the usual ones.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        *,
        status: int | None = None,
        errors: Sequence[ErrorItem] = (),
        hint: str | None = None,
        retryable: bool = False,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = STATUSES[code] if status is None else status
        self.code = code
        self.detail = detail
        self.errors = tuple(errors)
        self.hint = hint
        self.retryable = retryable
        self.headers = dict(headers or {})


def unprocessable(errors: Sequence[ErrorItem]) -> ApiError:
    """The answer to a request with things wrong in it."""
    count = "One thing is" if len(errors) == 1 else f"{len(errors)} things are"
    return ApiError("invalid_request", f"{count} wrong with the request.", errors=_listed(errors))


def _listed(errors: Sequence[ErrorItem]) -> list[ErrorItem]:
    """Some dozens of errors at most; the last one says how many more there are."""
    shown = [_cut(error) for error in errors[:_MAX_LISTED]]
    if more := len(errors) - len(shown):
        message = f"{more:,} more problems are not listed."
        shown.append(ErrorItem(code="more_problems", message=message, hint="Correct these first."))
    return shown


def _cut(error: ErrorItem) -> ErrorItem:
    """Without the rest of a field's name that is as long as the request."""
    if error.pointer is None or len(error.pointer) <= _MAX_POINTER:
        return error
    return error.model_copy(update={"pointer": error.pointer[:_MAX_POINTER] + "..."})


def service_away(code: str, detail: str, errors: Sequence[ErrorItem] = (), hint: str | None = None) -> ApiError:
    """The answer while a part of the service is away."""
    headers = {"Retry-After": str(_RETRY_AFTER_S)}
    return ApiError(code, detail, errors=errors, hint=hint, retryable=True, headers=headers)


def database_damaged() -> ApiError:
    """The answer until the operator has replaced the database."""
    hint = "The operator finds in the service's log what to do."
    return service_away("database_damaged", "The database is damaged.", hint=hint)


def pointer_to(*steps: str | int) -> str:
    """JSON pointer (RFC 6901) along some steps.

    >>> pointer_to("spec", "a/b")
    '/spec/a~1b'
    """
    return "".join("/" + str(step).replace("~", "~0").replace("/", "~1") for step in steps)


def title_of(status: int) -> str:
    """A status in words."""
    return _TITLES.get(status) or HTTPStatus(status).phrase


def problem_response(request: Request, error: ApiError) -> Response:
    """Render a problem."""
    problem = ProblemDetails(
        title=title_of(error.status),
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
    """What an exception means to the client; anything unforeseen is a 500 that says nothing of its insides."""
    match error:
        case ApiError():
            return error
        case HTTPException():
            return _from_status(error)
        case DamagedArtifact():
            return ApiError("artifact_damaged", "A stored file is damaged.")
        case DamagedDatabase():
            return database_damaged()
        case JobStoreError():
            return _from_store(error)
        case _:
            return _from_failure(error)


def handle(request: Request, error: Exception) -> Response:
    """Turn any exception into a problem; what the service is to blame for goes to the log."""
    answer = as_api_error(error)
    if answer.status >= 500:
        if isinstance(error, DamagedDatabase):
            _log.error("request_failed", code=answer.code, detail=str(error), instructions=error.instructions())
        else:
            _log.error("request_failed", code=answer.code, exc_info=error)
    if answer.status == 405:
        answer.headers["Allow"] = ", ".join(_methods_at(request))
    return problem_response(request, answer)


def install(app: FastAPI) -> None:
    """Make ``handle`` the handler of everything that routes raise on purpose.

    What nobody raised on purpose is caught by ``api.http.middleware.FailureAnswer``.
    """
    for kind in (ApiError, HTTPException, JobStoreError, ClientDisconnect):
        app.add_exception_handler(kind, handle)


def _methods_at(request: Request) -> Iterator[str]:
    """What the address of a request does take; the framework names the methods of one of its routes only."""
    for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"):
        # HEAD is answered by what answers GET, if by nothing else.
        scopes = [{**request.scope, "method": one} for one in (method, *(["GET"] if method == "HEAD" else []))]
        if any(route.matches(scope)[0] is Match.FULL for route in request.app.routes for scope in scopes):
            yield method


class _ProblemResponse(JSONResponse):
    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        # A client's JSON may hold lone surrogates, which come back in pointers and do not exist in UTF-8.
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


def _from_status(error: HTTPException) -> ApiError:
    status = error.status_code
    code = _CODES.get(status, HTTPStatus(status).name.lower())
    detail = _DETAILS.get(status, HTTPStatus(status).phrase)
    return ApiError(code, detail, status=status, retryable=status == 408, headers=error.headers)


def _from_store(error: JobStoreError) -> ApiError:
    match error:
        case NotFound():
            return ApiError("not_found", str(error))
        case QuotaExceeded():
            return _from_quota(error)
        case KeyReused():
            hint = "Make a new Idempotency-Key for each request; send the same only with the same request."
            return ApiError("idempotency_key_reused", str(error), hint=hint)
        case KeyBusy():
            headers = {"Retry-After": str(_RETRY_AFTER_S)}
            return ApiError("idempotency_key_busy", str(error), retryable=True, headers=headers)
        case _:
            return _from_conflict(error)


def _from_conflict(error: JobStoreError) -> ApiError:
    match error:
        case NotFinished():
            hint = "Ask for the job until its state is succeeded."
            return ApiError("not_finished", str(error), hint=hint, retryable=True)
        case NoResults():
            reason = f"The job's error is {error.reason} " if error.reason else ""
            return ApiError("no_results", str(error), hint=reason + _instead_of(error))
        case _:
            return ApiError("conflict", str(error))


def _instead_of(error: NoResults) -> str:
    """Advice for a job without results."""
    if error.state == "expired":
        return "Start another job of its session."
    return "Retry the job." if error.retryable else "Correct the input and send a new session."


def _from_quota(error: QuotaExceeded) -> ApiError:
    if error.name == "unfinished_jobs":
        hint = "Send it again when one of them has ended."
        headers = {"Retry-After": str(_QUOTA_RETRY_AFTER_S)}
        return ApiError("quota_exceeded", str(error), status=429, hint=hint, retryable=True, headers=headers)
    return ApiError("quota_exceeded", str(error), hint="Delete sessions that are no longer needed.")


def _storage_full() -> ApiError:
    hint = "Delete sessions that are no longer needed, or have the operator make room; then send it again."
    return ApiError("storage_full", "The service's disk is full.", hint=hint, retryable=True)


def _from_failure(error: Exception) -> ApiError:
    match error:
        case ClientDisconnect():
            return ApiError("client_disconnected", "The client hung up.", retryable=True)
        case _ if is_disk_full(error):
            return _storage_full()
        case OperationalError() | PoolTimeoutError():
            return service_away("database_unavailable", "The database is away.")
        case ArtifactsUnavailable():
            return service_away("artifacts_unavailable", "The artifact store is away.")
        case _:
            return ApiError("internal_error", "The service failed; the log says why.", retryable=True)
