"""Intake of messages of phones and hosts: clock, sizes, rates and fields, checked before anything is done with them."""

import asyncio
import struct
import time
from collections.abc import Awaitable, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from api.web.http.rates import Pace
from api.web.http.websockets import TOO_LARGE, WRONG_DATA, SocketProblem, wrong_message
from api.web.settings import Settings
from pipeline.core.problems import request_codes
from pipeline.run.live.packets import PICTURE_MAGIC

_Result = TypeVar("_Result")


def server_s() -> float:
    """Seconds since 1970; machines with API processes keep their clocks alike, such as by NTP."""
    return time.time()


async def in_time(way: Awaitable[_Result], wait_s: float | None, what: str) -> _Result:
    """Wait for a client; raises ``SocketProblem`` with the sentence ``what`` after ``wait_s``."""
    try:
        async with asyncio.timeout(wait_s):
            return await way
    except TimeoutError:
        raise SocketProblem(request_codes.RECORDING_IDLE, f"{what} for {wait_s:g} s.") from None


_Message = TypeVar("_Message")
_MAX_SIDE_PX = 1024


class RecordingIntake:
    """Messages of one connection, of an allowed size and at an allowed rate.

    ``must_send``: whether the connection ends if it is silent for ``recording_idle_s``.
    """

    def __init__(self, websocket: WebSocket, settings: Settings, *, must_send: bool) -> None:
        self._websocket, self._settings, self._must_send = websocket, settings, must_send
        self._pace = Pace(settings.max_recording_messages_per_s)

    async def receive(self) -> str | bytes:
        """Next message; raises ``SocketProblem`` or ``WebSocketDisconnect``."""
        wait_s = self._settings.recording_idle_s if self._must_send else None
        message: Mapping[str, Any] = await in_time(self._websocket.receive(), wait_s, "The client sent nothing")
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1005))
        if not self._pace.has_room():
            per_s = self._settings.max_recording_messages_per_s
            raise SocketProblem(request_codes.RECORDING_TOO_FAST, f"At most {per_s:g} messages a second are allowed.")
        content: str | bytes = message["text"] if message.get("text") is not None else message["bytes"]
        if isinstance(content, str):
            max_bytes = self._settings.max_recording_message_bytes
        elif content.startswith(PICTURE_MAGIC):
            max_bytes = self._settings.max_phone_picture_bytes
        else:
            max_bytes = self._settings.max_thumbnail_bytes
        if len(content) > max_bytes:
            raise too_large(max_bytes)
        return content


def parsed(content: str | bytes, adapter: TypeAdapter[_Message], models: Sequence[type[BaseModel]]) -> _Message:
    """Message in JSON of one of the models; raises ``SocketProblem`` with all that is wrong."""
    if isinstance(content, bytes):
        raise SocketProblem(request_codes.RECORDING_THUMBNAIL, "A message of bytes is not expected here.")
    try:
        return adapter.validate_json(content)
    except ValidationError:
        raise wrong_message(content, models, request_codes.RECORDING_MESSAGE, request_codes.RECORDING_FIELDS) from None


def require_jpeg(content: bytes) -> None:
    """Raise ``SocketProblem`` for bytes that are no JPEG, or one whose picture would fill the memory of hosts."""
    if max(_jpeg_size_px(content), default=0) not in range(1, _MAX_SIDE_PX + 1):
        detail = f"A picture is a JPEG of at most {_MAX_SIDE_PX} x {_MAX_SIDE_PX} pixels."
        raise SocketProblem(request_codes.RECORDING_THUMBNAIL, detail)


def _jpeg_size_px(content: bytes) -> tuple[int, ...]:
    """Height and width that the frame of a JPEG states (ITU-T T.81, B.2.2); empty without one."""
    at = 2 if content.startswith(b"\xff\xd8") else len(content)
    while at + 9 <= len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in {0xC4, 0xC8, 0xCC}:  # start of frame; tables and a reserved code
            return struct.unpack_from(">HH", content, at + 5)
        at += 2 + int.from_bytes(content[at + 2 : at + 4], "big")
    return ()


def too_large(max_bytes: int) -> SocketProblem:
    """Problem of a message with too many bytes."""
    return SocketProblem(request_codes.RECORDING_TOO_LARGE, f"This message has at most {max_bytes:,} bytes.", TOO_LARGE)


def wrong_text() -> SocketProblem:
    """Problem of a message that is no text, or of frames that break the protocol."""
    return SocketProblem(request_codes.RECORDING_MESSAGE, "The text of a message is not UTF-8.", WRONG_DATA)
