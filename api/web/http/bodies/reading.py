"""Reading request bodies: small bodies with a limit, large bodies in blocks."""

from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

from fastapi import HTTPException, Request, Response, status
from fastapi.routing import APIRoute
from starlette.types import Message

from api.web.dependencies import app_services

# Bytes that are passed to a thread at once: enough to make the thread's overhead small, little beside any memory limit.
_BLOCK_BYTES = 2**20
# Bytes that a refused client may still send: most clients read the response only after they have sent their body.
_DRAIN_BYTES = 64 * 2**20


class SmallBodyRoute(APIRoute):
    """Route whose body has at most ``Settings.max_json_bytes``, whatever its type and announced length."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Wrap the route's handler."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await handler(limited(request, app_services(request).settings.max_json_bytes))

        return handle


def limited(request: Request, max_bytes: int) -> Request:
    """Return the same request with a limited body: 413 is raised as soon as the body is longer."""
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
    """Length of a body by ``Content-Length``; 0 without the header."""
    announced = request.headers.get("content-length", "")
    return int(announced) if announced.isdecimal() else 0


async def blocks(stream: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """Join the pieces of a stream into blocks of about a MiB; the last block may be empty."""
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
    """Read and drop the rest of a body, up to a limit.

    If the connection were closed while the client still sends, the client would lose the response.
    """
    num_bytes = 0
    async for data in stream:
        num_bytes += len(data)
        if num_bytes > _DRAIN_BYTES:
            return
