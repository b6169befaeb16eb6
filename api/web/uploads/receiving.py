"""Bytes of a piece, from the body of a request to where they are stored."""

import hashlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Protocol

import anyio
from starlette.concurrency import run_in_threadpool

from api.web.errors import ApiError
from pipeline.core.problems.requests import CHECKSUM_MISMATCH, CONTENT_TOO_LARGE

BLOCK_BYTES = 2**20
"""Bytes that are passed to a thread at once."""

# Longest time between writes: on a slow connection, a killed service costs a client a second instead of a block.
_BLOCK_S = 1.0


@dataclass(frozen=True, slots=True)
class Checksum:
    """Expected checksum of a piece."""

    algorithm: str  # Name of the algorithm in hashlib
    digest: bytes


class Sink(Protocol):
    """Place that a piece is written to, from its beginning to its end."""

    def write(self, data: bytes) -> None:
        """Write the next bytes."""

    def finish(self) -> None:
        """Store for good what was written."""


async def receive(sink: Sink, num_bytes: int, stream: AsyncIterator[bytes]) -> int:
    """Write a body of at most ``num_bytes``; return the bytes that were written.

    Bytes that have arrived are written even if the request fails, as long as there is space. Raises 413 if more come.
    """
    pending: list[bytes] = []
    end, written_s = 0, time.monotonic()

    def write() -> None:
        nonlocal written_s
        data = b"".join(pending)
        pending.clear()
        written_s = time.monotonic()
        sink.write(data)

    def finish() -> None:
        write()
        sink.finish()

    try:
        async for data in stream:
            if end + len(data) > num_bytes:
                raise ApiError(CONTENT_TOO_LARGE, "The piece goes beyond the size that was announced for the upload.")
            pending.append(data)
            end += len(data)
            if sum(map(len, pending)) >= BLOCK_BYTES or time.monotonic() > written_s + _BLOCK_S:
                await run_in_threadpool(write)
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(finish)
    return end


class Compared:
    """Sink that computes the checksum of what is written to another one."""

    def __init__(self, sink: Sink, checksum: Checksum) -> None:
        self._sink, self._expected = sink, checksum.digest
        self._digest = hashlib.new(checksum.algorithm, usedforsecurity=False)

    def write(self, data: bytes) -> None:
        """Write the next bytes."""
        self._sink.write(data)
        self._digest.update(data)

    def finish(self) -> None:
        """Store for good what was written."""
        self._sink.finish()

    def require_equal(self) -> None:
        """Raise 460 unless all that was written has the checksum."""
        if self._digest.digest() != self._expected:
            raise ApiError(CHECKSUM_MISMATCH, "The piece that arrived does not have the checksum that was sent.")
