"""Places of live captures of this process: limits on their number, in total and by owner, and on bad ones."""

import asyncio
import contextlib
import math
import os
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator

from api.web.errors import ApiError, service_unavailable
from api.web.http.rates import MovingMinute
from pipeline.core.problems.request_codes import CAPTURES_BUSY, TOO_MANY_BAD_CAPTURES, TOO_MANY_CAPTURES

_RETRY_AFTER_S = 10
# Pause behind a start: this many times as long, and at most so many seconds.
_PAUSE, _MAX_PAUSE_S = 2.0, 0.5


class LivePlaces:
    """Counts of open live captures, and of captures of the last minute that ended by a client's fault.

    ``max_of_owner`` and ``max_bad_per_minute`` are limits of one owner, ``max_with_cameras`` is a limit of captures
    whose cameras the service opens.
    """

    def __init__(self, max_captures: int, max_of_owner: int, max_bad_per_minute: int, max_with_cameras: int) -> None:
        self._left_with_cameras = max_with_cameras
        # A start takes a processor; the others are left to captures that run.
        self._starts = asyncio.Semaphore(max(1, len(os.sched_getaffinity(0)) // 2))
        self._max_captures, self._max_of_owner = max_captures, max_of_owner
        self._open: Counter[str] = Counter()
        self._bad = MovingMinute(max_bad_per_minute)

    @contextlib.asynccontextmanager
    async def starting(self) -> AsyncIterator[None]:
        """Take a turn to start something; behind it comes a pause, in which captures that run make up for it."""
        await self._starts.acquire()
        began_s = time.monotonic()
        try:
            yield
        finally:
            pause_s = min(_MAX_PAUSE_S, _PAUSE * (time.monotonic() - began_s))
            asyncio.get_running_loop().call_later(pause_s, self._starts.release)

    @contextlib.contextmanager
    def with_cameras(self) -> Iterator[None]:
        """Take a place of a capture whose cameras the service opens; raises 503 if all are taken."""
        if not self._left_with_cameras:
            message = "Another live capture uses cameras of the service, and its processors."
            raise service_unavailable(CAPTURES_BUSY, message)
        self._left_with_cameras -= 1
        try:
            yield
        finally:
            self._left_with_cameras += 1

    def note_bad(self, owner: str) -> None:
        """Count a capture that ended by a fault of the client."""
        self._bad.hit(owner)

    @contextlib.contextmanager
    def taken(self, owner: str) -> Iterator[None]:
        """Take a place during the block.

        Raises 429 if the owner has all of its places, or had too many bad captures, 503 if all places are taken.
        """
        bad = self._bad.state(owner)
        if not bad.is_allowed:
            raise ApiError(
                TOO_MANY_BAD_CAPTURES,
                f"{self._bad.limit} live captures ended by problems of the client within a minute.",
                hint="Correct the client as the problems say, and begin the next capture later.",
                retryable=True,
                headers={"Retry-After": str(max(1, math.ceil(bad.reset_s)))},
            )
        if self._open[owner] >= self._max_of_owner:
            raise ApiError(
                TOO_MANY_CAPTURES,
                f"At most {self._max_of_owner} live captures may be open.",
                hint="End live captures that are over.",
                retryable=True,
                headers={"Retry-After": str(_RETRY_AFTER_S)},
            )
        if self._open.total() >= self._max_captures:
            raise service_unavailable(CAPTURES_BUSY, "The service has as many live captures as it can compute.")
        self._open[owner] += 1
        try:
            yield
        finally:
            self._open[owner] -= 1
            if not self._open[owner]:
                del self._open[owner]
