"""How bodies of requests are read: small ones with a limit, large ones in blocks."""

from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

from fastapi import HTTPException, Request, Response, status
from fastapi.routing import APIRoute
from starlette.types import Message

from api.dependencies import services_of

# Handed to a thread at a time: large enough that threads cost nothing, small against any limit on memory.
_BLOCK_BYTES = 2**20
# What a refused client may still send before it is cut off, so that most get to read why.
_DRAIN_BYTES = 64 * 2**20


class SmallBodyRoute(APIRoute):
    """A route that takes ``Settings.max_json_bytes`` at most, whatever the content's type and announced length."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Wrap the route's handler."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(limited(request, services_of(request).settings.max_json_bytes))

        return handle


def limited(request: Request, max_bytes: int) -> Request:
    """The same request, with a body that is refused (413) as soon as it is longer."""
    num_bytes = 0

    async def receive() -> Message:
        nonlocal num_bytes
        message = await request.receive()
        num_bytes += len(message.get("body", b""))
        if num_bytes > max_bytes:
            raise HTTPException(status.HTTP_413_CONTENT_TOO_LARGE)
        return message

    return Request(request.scope, receive)


def announced_bytes(request: Request) -> int:
    """How long a body is said to be; 0 if nothing is said."""
    announced = request.headers.get("content-length", "")
    return int(announced) if announced.isdecimal() else 0


async def blocks(stream: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Join what comes from the network into blocks worth a thread's while."""
    pending: list[bytes] = []
    num_bytes = 0
    async for data in stream:
        pending.append(data)
        num_bytes += len(data)
        if num_bytes >= _BLOCK_BYTES:
            yield b"".join(pending)
            pending, num_bytes = [], 0
    yield b"".join(pending)


async def drain(stream: AsyncIterator[bytes]) -> None:
    """Read on for a while: an answer to a client that still sends is lost with the connection."""
    num_bytes = 0
    async for data in stream:
        num_bytes += len(data)
        if num_bytes > _DRAIN_BYTES:
            return
