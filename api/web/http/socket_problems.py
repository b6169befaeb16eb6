"""Problems of WebSockets: the exception that ends a connection, its message, and the code that closes it."""

from collections.abc import Sequence
from typing import Literal, TypeVar

from pydantic import Field

from api.web.contract.schemas import ResponseModel
from api.web.errors import ApiError, ErrorItem, as_api_error
from pipeline.core.problems.model import Code

WRONG_DATA, REFUSED, TOO_LARGE, FAILED, LATER = 1007, 1008, 1009, 1011, 1013
"""Codes of RFC 6455, and 1013 of its registry, with which connections are closed."""

_RETRYABLE = frozenset({FAILED, LATER})
_STATUS_OF_LATER = frozenset({408, 429, 503, 507})


class SocketProblem(Exception):  # noqa: N818 - named as the message
    """A connection ends by a problem."""

    def __init__(
        self,
        code: Code,
        detail: str,
        close_code: int = REFUSED,
        errors: Sequence[ErrorItem] = (),
        hint: str | None = None,
    ) -> None:
        super().__init__(detail)
        self.code, self.detail, self.close_code = code, detail, close_code
        self.errors, self.hint = tuple(errors), hint


class SocketProblemOut(ResponseModel):
    """Base of the messages that state a problem."""

    type: Literal["problem"] = "problem"
    code: Code = Field(description="Stable name of the problem; docs/problems.md lists all codes.")
    detail: str = Field(description="Description of the problem, a sentence for a person.")
    errors: tuple[ErrorItem, ...] = Field(default=(), description="Everything that is wrong with the message.")
    hint: str | None = Field(default=None, description="Advice to the caller.")
    retryable: bool = Field(default=False, description="Whether the same may succeed later.")
    close_code: int | None = Field(description="Code with which the connection is closed.")
    request_id: str = Field(description="Id of the connection, also in the service's log.")


_Message = TypeVar("_Message", bound=SocketProblemOut)


def message_of(error: Exception, request_id: str, model: type[_Message]) -> _Message:
    """Message of any exception; an unforeseen one is ``internal_error``, without its text."""
    problem = socket_problem(error)
    return model(
        code=problem.code,
        detail=problem.detail,
        errors=problem.errors,
        hint=problem.hint,
        retryable=problem.close_code in _RETRYABLE,
        close_code=problem.close_code,
        request_id=request_id,
    )


def socket_problem(error: Exception) -> SocketProblem:
    """Problem of any exception, with the code that closes the connection."""
    return error if isinstance(error, SocketProblem) else _of_answer(as_api_error(error))


def _of_answer(error: ApiError) -> SocketProblem:
    is_later = error.status in _STATUS_OF_LATER
    close_code = LATER if is_later else FAILED if error.status >= 500 else REFUSED
    return SocketProblem(error.code, error.detail, close_code, error.errors, error.hint)
