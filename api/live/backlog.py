"""Queue of messages between two sides of different speed: the oldest messages are dropped, and counted."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator


class Backlog:
    """Messages that wait, limited in number and bytes; the oldest ones make room for new ones.

    Parameters
    ----------
    max_messages, max_bytes
        Limits of what waits. A message larger than ``max_bytes`` waits alone.
    """

    def __init__(self, max_messages: int, max_bytes: int) -> None:
        self._max_messages, self._max_bytes = max_messages, max_bytes
        self._waiting: deque[bytes] = deque()
        self._num_bytes = 0
        self._changed = asyncio.Event()
        self._is_closed = False
        self.num_dropped = 0

    def put(self, message: bytes) -> None:
        """Add a message."""
        while self._waiting and (
            len(self._waiting) >= self._max_messages or self._num_bytes + len(message) > self._max_bytes
        ):
            self._num_bytes -= len(self._waiting.popleft())
            self.num_dropped += 1
        self._waiting.append(message)
        self._num_bytes += len(message)
        self._changed.set()

    def close(self) -> None:
        """Add no more messages; what waits is still taken."""
        self._is_closed = True
        self._changed.set()

    async def taken(self) -> AsyncIterator[bytes]:
        """Take messages until the backlog is closed and empty."""
        while True:
            while not self._waiting:
                if self._is_closed:
                    return
                self._changed.clear()
                await self._changed.wait()
            message = self._waiting.popleft()
            self._num_bytes -= len(message)
            yield message
