"""Routes whose bodies are small: what is larger than any sane JSON is refused before it is in memory."""

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import HTTPException, Request, Response, status
from fastapi.routing import APIRoute
from starlette.types import Message

from api.dependencies import services_of


class SmallBodyRoute(APIRoute):
    """A route that takes ``Settings.max_json_bytes`` at most, whatever the content's type and announced length."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Wrap the route's handler."""
        handler = super().get_route_handler()

        async def handle(request: Request) -> Response:
            max_bytes = services_of(request).settings.max_json_bytes
            num_bytes = 0

            async def receive() -> Message:
                nonlocal num_bytes
                message = await request.receive()
                num_bytes += len(message.get("body", b""))
                if num_bytes > max_bytes:
                    raise HTTPException(status.HTTP_413_CONTENT_TOO_LARGE)
                return message

            return await handler(Request(request.scope, receive))

        return handle
