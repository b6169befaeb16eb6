"""Threads for long work of requests, such as checks of files: owners take turns, and waiting times are limited."""

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import anyio
from anyio import CapacityLimiter

from api.errors import ApiError, service_unavailable

_Result = TypeVar("_Result")

_RETRY_AFTER_S = 10
_MAX_WAITING = 32
"""Largest number of waiting requests of an owner; the files of each are on disk."""


class FairThreads:
    """Pool of threads that owners share.

    The owner with the fewest running calls is next; owners with equally many take turns. An owner never has all
    threads, unless there is only one thread. Methods must be called from the event loop's thread.

    Parameters
    ----------
    num_threads
        Number of calls that run at the same time.
    max_wait_s
        Longest time that a call waits for its turn before it is refused.
    """

    def __init__(self, num_threads: int, max_wait_s: float) -> None:
        self._free = num_threads
        self._share = max(1, num_threads - 1)
        self._max_wait_s = max_wait_s
        self._running: Counter[str] = Counter()
        # Waiting calls by owner; the owner whose last turn is longest ago comes first.
        self._waiting: OrderedDict[str, deque[asyncio.Future[None]]] = OrderedDict()
        # Separate from the threads that serve all other requests.
        self._threads = CapacityLimiter(num_threads)

    def require_room(self, owner: str) -> None:
        """Raise 429 if an owner has the largest number of waiting calls."""
        if len(self._waiting.get(owner, ())) >= _MAX_WAITING:
            raise _too_many_checks()

    async def run(
        self, owner: str, function: Callable[..., _Result], *arguments: object, further_wait_s: float = 0.0
    ) -> _Result:
        """Run a function in a thread when it is its owner's turn.

        Parameters
        ----------
        further_wait_s
            Waiting time of this call in addition to ``max_wait_s``.

        Raises
        ------
        ApiError
            After the waiting time: 429 if calls of the same owner are running, else 503.
        """
        await self._take_turn(owner, self._max_wait_s + further_wait_s)
        try:
            return await anyio.to_thread.run_sync(partial(function, *arguments), limiter=self._threads)
        finally:
            self._end_turn(owner)

    async def _take_turn(self, owner: str, max_wait_s: float) -> None:
        self.require_room(owner)
        turn = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(owner, deque()).append(turn)
        self._give_turns()
        try:
            async with asyncio.timeout(max_wait_s):
                await turn
        except TimeoutError:
            self._leave(owner, turn)
            raise _too_many_checks() if self._running[owner] else _busy() from None
        except BaseException:
            self._leave(owner, turn)
            raise

    def _leave(self, owner: str, turn: asyncio.Future[None]) -> None:
        if turn.done() and not turn.cancelled():  # the turn was given at the same moment
            self._end_turn(owner)
            return
        queue = self._waiting[owner]
        queue.remove(turn)
        if not queue:
            del self._waiting[owner]

    def _end_turn(self, owner: str) -> None:
        self._running[owner] -= 1
        if not self._running[owner]:
            del self._running[owner]
        self._free += 1
        self._give_turns()

    def _give_turns(self) -> None:
        while self._free and (owner := self._next_owner()) is not None:
            queue = self._waiting[owner]
            turn = queue.popleft()
            self._waiting.move_to_end(owner)
            if not queue:
                del self._waiting[owner]
            self._running[owner] += 1
            self._free -= 1
            turn.set_result(None)

    def _next_owner(self) -> str | None:
        owners = [owner for owner in self._waiting if self._running[owner] < self._share]
        return min(owners, key=self._running.__getitem__, default=None)


def _too_many_checks() -> ApiError:
    return ApiError(
        "too_many_checks",
        "Too many of your sessions are being checked at once.",
        hint="Send the session again when one of them has been answered. Files of uploads need not be sent again.",
        retryable=True,
        headers={"Retry-After": str(_RETRY_AFTER_S)},
    )


def _busy() -> ApiError:
    error = service_unavailable("checks_busy", "The service is busy with the files of other tenants.")
    error.headers["Retry-After"] = str(_RETRY_AFTER_S)
    return error
