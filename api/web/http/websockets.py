"""WebSockets: problems that end them, refusals before they open, and a protocol that lets no client hold up others."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeVar

import uuid_utils
from pydantic import BaseModel, Field, ValidationError
from pydantic_core import from_json
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode

from api.web.contract.schemas import ID, ResponseModel
from api.web.errors import ApiError, ErrorItem, as_api_error, problem_response
from api.web.http.bodies.validation import NO_PLACES, model_items
from api.web.http.middleware import SAFE_HEADERS, ForeignPageGuard
from pipeline.core.problems.code_group import Code

WRONG_DATA, REFUSED, TOO_LARGE, FAILED, LATER = 1007, 1008, 1009, 1011, 1013
"""Codes of RFC 6455, and 1013 of its registry, with which connections are closed."""

WRONG_FIELDS = "Fields of the message are wrong."
"""Sentence of a problem that lists fields."""

_RETRYABLE = frozenset({FAILED, LATER})
_STATUS_OF_LATER = frozenset({408, 429, 503, 507})

_PROTOCOL_ERROR = 1002
_MAX_SHOWN = 40
# Bytes that are parsed at once. A loop reads 256 KiB, and a thousand small messages would hold up other connections.
_PIECE_BYTES = 4096
# Longest time, and time without a byte, until the connection of a client with wrong frames is closed.
_DISCARDING_S, _QUIET_S = 5.0, 0.3


class SocketProblem(Exception):  # noqa: N818 - named as the message
    """A connection ends by a problem."""

    def __init__(
        self,
        code: Code,
        detail: str,
        close_code: int = REFUSED,
        errors: Sequence[ErrorItem] = (),
        hint: str | None = None,
    ) -> None:
        super().__init__(detail)
        self.code, self.detail, self.close_code = code, detail, close_code
        self.errors, self.hint = tuple(errors), hint


class SocketProblemOut(ResponseModel):
    """Base of the messages that state a problem."""

    type: Literal["problem"] = "problem"
    code: Code = Field(
        description="Stable name of the problem; `/help/problems` lists all codes.", examples=["internal_error"]
    )
    detail: str = Field(
        description="Description of the problem, a sentence for a person.",
        examples=["The service failed; the log says why."],
    )
    errors: tuple[ErrorItem, ...] = Field(default=(), description="Everything that is wrong with the message.")
    hint: str | None = Field(default=None, description="Advice to the caller.")
    retryable: bool = Field(default=False, description="Whether the same may succeed later.")
    close_code: int | None = Field(description="Code with which the connection is closed.")
    request_id: str = Field(description="Id of the connection, also in the service's log.", examples=[ID])


_Message = TypeVar("_Message", bound=SocketProblemOut)


def problem_message(error: Exception, request_id: str, model: type[_Message]) -> _Message:
    """Message of any exception; an unforeseen one is ``internal_error``, without its text."""
    problem = socket_problem(error)
    return model(
        code=problem.code,
        detail=problem.detail,
        errors=problem.errors,
        hint=problem.hint,
        retryable=problem.close_code in _RETRYABLE,
        close_code=problem.close_code,
        request_id=request_id,
    )


def wrong_message(text: str, models: Sequence[type[BaseModel]], message: Code, fields: Code) -> SocketProblem:
    """Problem of a text that is no message of the models, which have a field ``type``.

    ``fields`` is the code of a message with wrong fields, ``message`` of another text.
    """
    try:
        content = from_json(text)
    except ValueError:
        return SocketProblem(message, "The message is not JSON.", WRONG_DATA)
    by_type = {str(model.model_fields["type"].annotation.__args__[0]): model for model in models}  # type: ignore[union-attr]
    kind = content.get("type") if isinstance(content, dict) else None
    model = by_type.get(kind) if isinstance(kind, str) else None
    if model is None:
        shown = f", not {kind[:_MAX_SHOWN]!r}" if isinstance(kind, str) else ""
        return SocketProblem(message, f"A message of the type {' or '.join(by_type)} is expected here{shown}.")
    try:
        model.model_validate_json(text)
    except ValidationError as error:
        return SocketProblem(fields, WRONG_FIELDS, errors=model_items(error, model, NO_PLACES))
    return SocketProblem(message, "The message can't be read.")


def socket_problem(error: Exception) -> SocketProblem:
    """Problem of any exception, with the code that closes the connection."""
    return error if isinstance(error, SocketProblem) else _from_api_error(as_api_error(error))


def _from_api_error(error: ApiError) -> SocketProblem:
    is_later = error.status in _STATUS_OF_LATER
    close_code = LATER if is_later else FAILED if error.status >= 500 else REFUSED
    return SocketProblem(error.code, error.detail, close_code, error.errors, error.hint)


async def deny(websocket: WebSocket, error: ApiError) -> None:
    """Answer the request to open a WebSocket by a problem, as a request of HTTP."""
    response = problem_response(websocket, error)
    response.headers.update({**SAFE_HEADERS, "X-Request-ID": websocket.state.request_id})
    await websocket.send_denial_response(response)


class WebSocketGuard:
    """Middleware of WebSockets: gives each an id, and refuses those that pages of other origins open."""

    def __init__(self, app: ASGIApp, guard: ForeignPageGuard) -> None:
        self._app, self._guard = app, guard

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket; other scopes pass."""
        if scope["type"] == "websocket":
            scope.setdefault("state", {})["request_id"] = str(uuid_utils.uuid7())
            if error := self._guard.refusal(HTTPConnection(scope).headers):
                await deny(WebSocket(scope, receive, send), error)
                return
        await self._app(scope, receive, send)


def bounded_websocket(last_message: Callable[[str, int], str | None]) -> type[WebSocketsSansIOProtocol]:
    """Protocol of WebSockets that lets no client hold up others.

    Of what a client sends at once, a piece is parsed at a time, and no more than is received. A client whose frames are
    wrong gets ``last_message`` of the path and the close code, unless it is ``None``, before the connection is closed.
    """

    class BoundedWebSocket(WebSocketsSansIOProtocol):
        _is_discarding = False
        _discarding_until_s = 0.0

        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self._unread = bytearray()

        def data_received(self, data: bytes) -> None:
            if self._is_discarding:
                self._close_when_quiet()
                return
            self._unread += data
            self._parse()

        def _parse(self) -> None:
            """Parse a piece of what has come, and soon the next one, unless messages wait for being received."""
            if self.read_paused or self.transport.is_closing():
                return
            if self._unread:
                piece = bytes(self._unread[:_PIECE_BYTES])
                del self._unread[:_PIECE_BYTES]
                super().data_received(piece)
            if self._is_discarding:
                self._unread.clear()
            if self.read_paused or self.transport.is_closing():
                return
            if self._unread:
                self.transport.pause_reading()
                self.loop.call_soon(self._parse)
            else:
                self.transport.resume_reading()

        async def receive(self) -> Any:
            message = await self.queue.get()
            if self.read_paused and self.queue.empty():
                self.read_paused = False
                self._parse()
            return message

        async def send(self, message: Any) -> None:
            await super().send(message)
            self._parse()  # behind a close the answer to it may be there
            if message["type"] == "websocket.http.response.body" and not message.get("more_body", False):
                # The answer in place of the WebSocket is complete, and nothing has failed.
                self.handshake_complete = True

        def handle_parser_exception(self) -> None:
            """Send the last message, and discard what still comes: closed at once, the client would not get it."""
            self._is_discarding = True
            close = self.conn.close_sent
            code, reason = (close.code, close.reason) if close is not None else (_PROTOCOL_ERROR, "")
            self.queue.put_nowait({"type": "websocket.disconnect", "code": code, "reason": reason})
            text = last_message(self.scope["path"], code) if self.handshake_complete else None
            message = b"" if text is None else Frame(Opcode.TEXT, text.encode()).serialize(mask=False)
            self.transport.write(b"".join([message, *self.conn.data_to_send()]))
            self.close_sent = True
            self._discarding_until_s = self.loop.time() + _DISCARDING_S
            self._close_when_quiet()
            if self.read_paused:
                self.read_paused = False
                self.transport.resume_reading()

        def _close_when_quiet(self) -> None:
            if self.close_timer is not None:
                self.close_timer.cancel()
            close_s = min(self._discarding_until_s, self.loop.time() + _QUIET_S)
            self.close_timer = self.loop.call_at(close_s, self.transport.close)

    return BoundedWebSocket
