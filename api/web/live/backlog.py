"""Queue of messages between two sides of different speed: the oldest messages are dropped, and counted."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import NamedTuple


class Waiting(NamedTuple):
    """Message that waits."""

    content: bytes
    since_s: float  # When the frame behind it came, by the monotonic clock


class Backlog:
    """Messages that wait, limited in number and bytes; the oldest ones make room for new ones.

    ``max_messages``, ``max_bytes``: limits of what waits. A message larger than ``max_bytes`` waits alone. ``on_drop``:
    called with the number of messages that were dropped at once.
    """

    def __init__(self, max_messages: int, max_bytes: int, on_drop: Callable[[int], None]) -> None:
        self._max_messages, self._max_bytes, self._on_drop = max_messages, max_bytes, on_drop
        self._waiting: deque[Waiting] = deque()
        self._num_bytes = 0
        self._changed = asyncio.Event()
        self._is_closed = False
        self.num_dropped = 0

    def put(self, content: bytes, since_s: float) -> None:
        """Add a message; ``since_s`` is when the frame behind it came."""
        num_dropped = 0
        while self._waiting and (
            len(self._waiting) >= self._max_messages or self._num_bytes + len(content) > self._max_bytes
        ):
            self._num_bytes -= len(self._waiting.popleft().content)
            num_dropped += 1
        if num_dropped:
            self.num_dropped += num_dropped
            self._on_drop(num_dropped)
        self._waiting.append(Waiting(content, since_s))
        self._num_bytes += len(content)
        self._changed.set()

    def close(self) -> None:
        """Add no more messages; what waits is still taken."""
        self._is_closed = True
        self._changed.set()

    async def taken(self) -> AsyncIterator[Waiting]:
        """Take messages until the backlog is closed and empty."""
        while True:
            while not self._waiting:
                if self._is_closed:
                    return
                self._changed.clear()
                await self._changed.wait()
            message = self._waiting.popleft()
            self._num_bytes -= len(message.content)
            yield message
