"""Clock that the service tells phones, and waits with a limit."""

import asyncio
import time
from collections.abc import Awaitable
from typing import TypeVar

from api.web.http.websockets import SocketProblem
from pipeline.core.problems.requests import RECORDING_IDLE

_Result = TypeVar("_Result")


def server_s() -> float:
    """Seconds since 1970; machines with API processes keep their clocks alike, such as by NTP."""
    return time.time()


async def in_time(way: Awaitable[_Result], wait_s: float | None, what: str) -> _Result:
    """Wait for a client; raises ``SocketProblem`` with the sentence ``what`` after ``wait_s``."""
    try:
        async with asyncio.timeout(wait_s):
            return await way
    except TimeoutError:
        raise SocketProblem(RECORDING_IDLE, f"{what} for {wait_s:g} s.") from None
