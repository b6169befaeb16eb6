"""Places of live captures of this process: limits on their number, in total and by owner."""

import asyncio
import contextlib
import os
from collections import Counter
from collections.abc import Iterator

from api.errors import ApiError, service_unavailable
from pipeline.problem_codes.requests import CAPTURES_BUSY, TOO_MANY_CAPTURES

_RETRY_AFTER_S = 10


class LivePlaces:
    """Counts of open live captures."""

    def __init__(self, max_captures: int, max_of_owner: int) -> None:
        # A start takes a processor for seconds; the others are left to captures that run.
        self.starting = asyncio.Semaphore(max(1, len(os.sched_getaffinity(0)) // 2))
        self._max_captures, self._max_of_owner = max_captures, max_of_owner
        self._open: Counter[str] = Counter()

    @contextlib.contextmanager
    def taken(self, owner: str) -> Iterator[None]:
        """Take a place during the block; raises 429 if the owner has all of its places, 503 if all are taken."""
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
