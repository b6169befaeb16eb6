"""Problems that end live captures from several places."""

from api.http.socket_problems import FAILED, TOO_LARGE, WRONG_DATA, SocketProblem
from pipeline.problem_codes.live import LIVE_FAILED, LIVE_MESSAGE, LIVE_TOO_LARGE


def failed() -> SocketProblem:
    """Problem of a process that crashed or hangs."""
    return SocketProblem(LIVE_FAILED, "The computation of the capture failed; the log says why.", FAILED)


def too_large(max_bytes: int) -> SocketProblem:
    """Problem of a message with too many bytes."""
    return SocketProblem(LIVE_TOO_LARGE, f"A message has at most {max_bytes:,} bytes.", TOO_LARGE)


def wrong_text() -> SocketProblem:
    """Problem of a message that is no text, or of frames that break the protocol."""
    return SocketProblem(LIVE_MESSAGE, "The text of a message is not UTF-8.", WRONG_DATA)
