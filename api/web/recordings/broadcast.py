"""Messages about recordings between API processes, by the broker's publish and subscribe.

Nothing depends on them: rows are the truth, and every process polls the revisions of its open recordings. Messages make
changes known at once, and carry what is no row: what phones say of themselves, and pictures. Of each kind only the
newest message of a phone waits to be sent, so that a slow broker delays no other phone.
"""

import asyncio
import contextlib
import uuid
from collections.abc import Callable
from enum import Enum
from typing import Any
from urllib.parse import unquote

import redis.asyncio
import structlog
from redis.exceptions import RedisError

from worker.store import outages

_log = structlog.get_logger(__name__)

_CHANNEL = "multicap.recording."
_TIMEOUT_S = 2.0
_AGAIN_S = 1.0
_SOCKET_SCHEME = "redis+socket://"


class RelayKind(Enum):
    """Kind of a message."""

    CHANGED = b"C"  # rows of the recording have changed
    PHONE = b"P"  # what is known of a phone, in JSON; an earlier connection of it ends
    THUMBNAIL = b"T"  # number of a phone, and a JPEG
    HOST = b"H"  # a host is connected, and wants thumbnails
    LIVE = b"L"  # phones that are cameras of live captures, in JSON: calibrated sizes by their numbers
    PICTURE = b"F"  # number of such a phone, and a packet with its picture


OnMessage = Callable[[str, RelayKind, bytes], None]


class RecordingRelay:
    """Relay of one process. ``broker_url``: Celery's."""

    def __init__(self, broker_url: str) -> None:
        self._client: redis.asyncio.Redis = _open_client(broker_url)
        self._origin = uuid.uuid4().bytes
        self._channels: set[str] = set()
        self._subscribed: set[str] = set()
        self._waiting: dict[tuple[str, RelayKind, int], bytes] = {}
        self._has_waiting, self._has_channels = asyncio.Event(), asyncio.Event()
        self.is_away = False

    def subscribe(self, recording_id: str) -> None:
        """Receive the messages of a recording from now on."""
        self._channels.add(recording_id)
        self._has_channels.set()

    def unsubscribe(self, recording_id: str) -> None:
        """Receive the messages of a recording no longer."""
        self._channels.discard(recording_id)

    def publish(self, recording_id: str, kind: RelayKind, phone: int = 0, content: bytes = b"") -> None:
        """Send a message to the other processes, in place of one of the same kind and phone that still waits."""
        self._waiting[recording_id, kind, phone] = content
        self._has_waiting.set()

    async def run(self, on_message: OnMessage) -> None:
        """Relay until it is canceled."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._publish_forever())
                tasks.create_task(self._receive_forever(on_message))
        finally:
            with contextlib.suppress(RedisError, OSError):
                await self._client.aclose()

    async def _publish_forever(self) -> None:
        while True:
            await self._has_waiting.wait()
            self._has_waiting.clear()
            waiting, self._waiting = self._waiting, {}
            try:
                for (recording_id, kind, _), content in waiting.items():
                    async with asyncio.timeout(_TIMEOUT_S):
                        await self._client.publish(_CHANNEL + recording_id, self._origin + kind.value + content)
                self._note(is_away=False)
            except (RedisError, OSError, TimeoutError):
                self._note(is_away=True)
                await asyncio.sleep(_AGAIN_S)

    async def _receive_forever(self, on_message: OnMessage) -> None:
        while True:
            await self._has_channels.wait()
            try:
                async with self._client.pubsub(ignore_subscribe_messages=True) as messages:
                    self._subscribed.clear()
                    while self._channels:
                        await self._follow(messages)
                        message = await messages.get_message(timeout=0.2)
                        self._note(is_away=False)
                        if message is not None:
                            self._take(message, on_message)
                self._has_channels.clear()
                if self._channels:  # added meanwhile
                    self._has_channels.set()
            except (RedisError, OSError, TimeoutError):
                self._note(is_away=True)
                await asyncio.sleep(_AGAIN_S)

    async def _follow(self, messages: redis.asyncio.client.PubSub) -> None:
        """Subscribe to the channels that are wanted, and to no others."""
        if missing := self._channels - self._subscribed:
            await messages.subscribe(*(_CHANNEL + recording_id for recording_id in missing))
        if superfluous := self._subscribed - self._channels:
            await messages.unsubscribe(*(_CHANNEL + recording_id for recording_id in superfluous))
        self._subscribed = set(self._channels)

    def _take(self, message: dict[str, bytes], on_message: OnMessage) -> None:
        data, size = message["data"], len(self._origin)
        if data[:size] == self._origin:
            return
        recording_id = message["channel"].decode().removeprefix(_CHANNEL)
        try:
            on_message(recording_id, RelayKind(data[size : size + 1]), data[size + 1 :])
        except ValueError:
            _log.warning("recording_message_unknown")  # of a newer version

    def _note(self, *, is_away: bool) -> None:
        if is_away and not self.is_away:
            _log.warning("recording_relay_away")
        self.is_away = is_away


def _open_client(broker_url: str) -> redis.asyncio.Redis:
    """Client of the broker, whose address is Celery's."""
    address = broker_url.partition(";")[0]
    if address.startswith(_SOCKET_SCHEME):
        address = f"unix://{unquote(address.removeprefix(_SOCKET_SCHEME))}"
    tcp: dict[str, Any] = {"socket_keepalive": True, "socket_keepalive_options": dict(outages.SOCKET_OPTIONS)}
    options = {} if address.startswith("unix:") else tcp
    return redis.asyncio.Redis.from_url(
        address, socket_connect_timeout=_TIMEOUT_S, socket_timeout=_TIMEOUT_S, **options
    )
