"""Problems that end live captures from several places."""

import json

from api.web.errors import ErrorItem
from api.web.http.websockets import FAILED, TOO_LARGE, WRONG_DATA, SocketProblem
from pipeline.core.problems import request_codes

# A computation that fails may be the service's fault; a client that has it fail again and again waits, too.
_FAULTS = frozenset(
    {
        request_codes.LIVE_CAMERA,
        request_codes.LIVE_FAILED,
        request_codes.LIVE_FIELDS,
        request_codes.LIVE_JOINTS,
        request_codes.LIVE_MESSAGE,
        request_codes.LIVE_PACKET,
        request_codes.LIVE_TIME,
        request_codes.LIVE_TOO_FAST,
    }
    | {request_codes.LIVE_TOO_LARGE}
)
# Frames that the server itself has refused: 1002 breaks the protocol.
_FAULTY_CLOSES = frozenset({1002, WRONG_DATA, TOO_LARGE})


def is_fault(code: str | None, close_code: int) -> bool:
    """Return whether a capture that ended with a problem's code and a close code ended by a fault of the client."""
    return code in _FAULTS or close_code in _FAULTY_CLOSES


def failed() -> SocketProblem:
    """Problem of a process that crashed or hangs."""
    return SocketProblem(request_codes.LIVE_FAILED, "The computation of the capture failed; the log says why.", FAILED)


def too_large(max_bytes: int) -> SocketProblem:
    """Problem of a message with too many bytes."""
    return SocketProblem(request_codes.LIVE_TOO_LARGE, f"A message has at most {max_bytes:,} bytes.", TOO_LARGE)


def wrong_text() -> SocketProblem:
    """Problem of a message that is no text, or of frames that break the protocol."""
    return SocketProblem(request_codes.LIVE_MESSAGE, "The text of a message is not UTF-8.", WRONG_DATA)


def refused(answer: bytes) -> SocketProblem:
    """Problem of a capture that its process can't begin: a list of problems in JSON."""
    errors = [ErrorItem(**problem) for problem in json.loads(answer)]
    return SocketProblem(request_codes.LIVE_FIELDS, "The capture can't begin with these choices.", errors=errors)
