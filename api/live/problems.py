"""Ends of live captures by a problem: the exception, its message, and the code that closes the connection."""

from collections.abc import Sequence

from api.errors import ApiError, ErrorItem, as_api_error
from api.live.schemas import LiveProblemOut
from pipeline.problem_codes.live import LIVE_FAILED, LIVE_MESSAGE, LIVE_TOO_LARGE
from pipeline.problem_codes.model import Code

WRONG_DATA, REFUSED, TOO_LARGE, FAILED, LATER = 1007, 1008, 1009, 1011, 1013
"""Codes of RFC 6455, and 1013 of its registry, with which connections are closed."""

_RETRYABLE = frozenset({FAILED, LATER})
_STATUS_OF_LATER = frozenset({408, 429, 503, 507})


class LiveProblem(Exception):  # noqa: N818 - named as the message
    """A live capture ends by a problem."""

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


def failed() -> LiveProblem:
    """Problem of a process that crashed or hangs."""
    return LiveProblem(LIVE_FAILED, "The computation of the capture failed; the log says why.", FAILED)


def too_large(max_bytes: int) -> LiveProblem:
    """Problem of a message with too many bytes."""
    return LiveProblem(LIVE_TOO_LARGE, f"A message has at most {max_bytes:,} bytes.", TOO_LARGE)


def wrong_text() -> LiveProblem:
    """Problem of a message that is no text, or of frames that break the protocol."""
    return LiveProblem(LIVE_MESSAGE, "The text of a message is not UTF-8.", WRONG_DATA)


def message_of(error: Exception, request_id: str) -> LiveProblemOut:
    """Message of any exception; an unforeseen one is ``internal_error``, without its text."""
    problem = error if isinstance(error, LiveProblem) else _of_answer(as_api_error(error))
    return LiveProblemOut(
        code=problem.code,
        detail=problem.detail,
        errors=problem.errors,
        hint=problem.hint,
        retryable=problem.close_code in _RETRYABLE,
        close_code=problem.close_code,
        request_id=request_id,
    )


def _of_answer(error: ApiError) -> LiveProblem:
    is_later = error.status in _STATUS_OF_LATER
    close_code = LATER if is_later else FAILED if error.status >= 500 else REFUSED
    return LiveProblem(error.code, error.detail, close_code, error.errors, error.hint)
