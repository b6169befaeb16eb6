"""Turns for the work of requests: owners share them fairly, and both the number and the time of waiting are limited."""

import asyncio
import contextlib
import math
from collections import Counter, OrderedDict, deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import anyio
from anyio import CapacityLimiter

from api.web.errors import ApiError, service_unavailable
from pipeline.core.problems.request_codes import CHECKS_BUSY, SERVICE_BUSY, TOO_MANY_AT_ONCE, TOO_MANY_CHECKS

_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True)
class ShareLimits:
    """Limits of turns, and the errors of requests that exceed them.

    - ``num_turns``: turns that are taken at the same time.
    - ``share``: turns that an owner has at the same time.
    - ``max_waiting``: waiting requests of an owner.
    - ``max_wait_s``: longest time that a request waits for its turn before it is refused.
    - ``too_many``: makes the error of an owner who uses up its share.
    - ``busy``: makes the error of an owner who waits for others.
    """

    num_turns: int
    share: int
    max_waiting: float
    max_wait_s: float
    too_many: Callable[[], ApiError]
    busy: Callable[[], ApiError]


class FairShare:
    """Turns that owners share.

    The owner with the fewest turns is next; owners with equally many take turns. Methods must be called from the event
    loop's thread.
    """

    def __init__(self, limits: ShareLimits) -> None:
        self._limits = limits
        self._free = limits.num_turns
        self._taken: Counter[str] = Counter()
        # Waiting requests by owner; the owner whose last turn is longest ago comes first.
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()

    def require_room(self, owner: str) -> None:
        """Raise 429 if an owner has the largest number of waiting requests."""
        if len(self._waiting.get(owner, ())) >= self._limits.max_waiting:
            raise self._limits.too_many()

    @contextlib.asynccontextmanager
    async def turn(self, owner: str, further_wait_s: float = 0.0) -> AsyncIterator[None]:
        """Wait for a turn, and keep it during the block.

        ``further_wait_s``: waiting time of this request in addition to ``max_wait_s``. Raises ``ApiError`` after the
        waiting time: 429 if the owner has a turn, else 503.
        """
        await self._take(owner, self._limits.max_wait_s + further_wait_s)
        try:
            yield
        finally:
            self._end(owner)

    async def _take(self, owner: str, max_wait_s: float) -> None:
        self.require_room(owner)
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(owner, deque()).append(turn)
        self._give()
        try:
            async with asyncio.timeout(max_wait_s):
                await turn
        except TimeoutError:
            self._leave(owner, turn)
            raise self._limits.too_many() if self._taken[owner] else self._limits.busy() from None
        except BaseException:
            self._leave(owner, turn)
            raise

    def _leave(self, owner: str, turn: asyncio.Future[None]) -> None:
        if turn.done() and not turn.cancelled():  # the turn was given at the same moment
            self._end(owner)
            return
        queue = self._waiting[owner]
        queue.remove(turn)
        if not queue:
            del self._waiting[owner]

    def _end(self, owner: str) -> None:
        self._taken[owner] -= 1
        if not self._taken[owner]:
            del self._taken[owner]
        self._free += 1
        self._give()

    def _give(self) -> None:
        while self._free and (owner := self._next_owner()) is not None:
            queue = self._waiting[owner]
            turn = queue.popleft()
            self._waiting.move_to_end(owner)
            if not queue:
                del self._waiting[owner]
            self._taken[owner] += 1
            self._free -= 1
            turn.set_result(None)

    def _next_owner(self) -> str | None:
        owners = [owner for owner in self._waiting if self._taken[owner] < self._limits.share]
        return min(owners, key=self._taken.__getitem__, default=None)


class FairThreads(FairShare):
    """Turns with a thread each, apart from the threads of all other work."""

    def __init__(self, limits: ShareLimits) -> None:
        super().__init__(limits)
        self._threads = CapacityLimiter(limits.num_turns)

    async def run(
        self, owner: str, function: Callable[..., _Result], *arguments: object, further_wait_s: float = 0.0
    ) -> _Result:
        """Run a function in a thread when it is its owner's turn; parameters and errors as ``turn``."""
        async with self.turn(owner, further_wait_s):
            return await anyio.to_thread.run_sync(partial(function, *arguments), limiter=self._threads)


def share_of_requests() -> FairShare:
    """Turns of routes that answer at once: their work is mostly Python's, of which one thread runs at a time."""
    return FairShare(ShareLimits(12, 4, 256, 30.0, _too_many_requests, _requests_busy))


def threads_of_blocks() -> FairThreads:
    """Threads that read and compress blocks of files that are sent. Connections are limited, so none is refused."""
    return FairThreads(ShareLimits(8, 4, math.inf, math.inf, _too_many_requests, _requests_busy))


def threads_of_checks(num_threads: int, max_wait_s: float) -> FairThreads:
    """Threads that check files. An owner never has all of them, unless there is only one; waiting files are on disk."""
    share = max(1, num_threads - 1)
    return FairThreads(ShareLimits(num_threads, share, 32, max_wait_s, _too_many_checks, _checks_busy))


def _too_many_requests() -> ApiError:
    return ApiError(
        TOO_MANY_AT_ONCE,
        "Too many of your requests wait to be answered.",
        hint="Wait for the answers of earlier requests before you send more.",
        retryable=True,
        headers={"Retry-After": "2"},
    )


def _requests_busy() -> ApiError:
    return service_unavailable(SERVICE_BUSY, "The service is busy with the requests of other tenants.")


def _too_many_checks() -> ApiError:
    return ApiError(
        TOO_MANY_CHECKS,
        "Too many of your captures are being checked at once.",
        hint="Send the capture again when one of them has been answered. Files of uploads need not be sent again.",
        retryable=True,
        headers={"Retry-After": "10"},
    )


def _checks_busy() -> ApiError:
    error = service_unavailable(CHECKS_BUSY, "The service is busy with the files of other tenants.")
    error.headers["Retry-After"] = "10"
    return error
