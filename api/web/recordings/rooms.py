"""Rooms: recordings that are open at this process, with the phones and hosts that are connected here."""

import asyncio
import contextlib
import json
import socket
import struct
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import structlog
from starlette.concurrency import run_in_threadpool

from api.web.http.websockets import LATER, SocketProblem
from api.web.recordings.broadcast import RecordingRelay, RelayKind
from api.web.recordings.intake import server_s
from pipeline.core.problems.request_codes import RECORDING_BUSY
from pipeline.run.live.packets import PhonePicture
from worker.store.errors import NotFound
from worker.store.model.phone_records import RecordingSession
from worker.store.store import JobStore
from worker.store.tenant_records import TenantRecords

_log = structlog.get_logger(__name__)

_POLL_S = 0.5
# How often processes say which phones and hosts they have, and when such news are old.
_TELL_S, _OLD_S = 2.0, 6.0
_NUMBER = struct.Struct("<H")

Reason = Literal["recording", "removed", "replaced"]


class RecordingOver(Exception):  # noqa: N818 - an end, no error
    """The recording, or a connection to it, has ended as it should."""

    def __init__(self, reason: Reason) -> None:
        self.reason: Reason = reason


@dataclass(slots=True)
class LivePhone:
    """Phone as it is at the moment."""

    is_connected: bool = False
    status: dict[str, Any] | None = None
    hello: dict[str, Any] | None = None
    since_s: float = 0.0  # Time of its connection by the database's clock, which all processes share
    told_s: float = 0.0  # When another process told it, by the monotonic clock

    def encode(self, number: int) -> bytes:
        """Form for other processes."""
        content = {"phone": number, "connected": self.is_connected, "status": self.status, "hello": self.hello}
        return json.dumps({**content, "since_s": self.since_s}, separators=(",", ":")).encode()


@dataclass(slots=True, eq=False)
class Side:
    """Side of a connection that sends: it is woken when there may be something to send."""

    wake: asyncio.Event = field(default_factory=asyncio.Event)
    is_replaced: bool = False  # The same phone has connected again


@dataclass(slots=True, eq=False)
class HostSide(Side):
    """Side of a host. Of each phone the newest thumbnail waits."""

    thumbnails: dict[int, bytes] = field(default_factory=dict)
    has_news: bool = True


Size = tuple[int, int] | None
"""Width and height in pixels that a phone's camera was calibrated at; ``None``: unknown."""


class LiveTaker(NamedTuple):
    """Camera of a live capture that takes the pictures of a phone."""

    phone: int
    size_px: Size
    pictures: socket.socket  # to the process that decodes them

    def take(self, picture: PhonePicture) -> None:
        """Pass a picture on; while earlier ones wait, it is dropped."""
        machine_s = picture.time_s - server_s() + time.monotonic()
        with contextlib.suppress(OSError):  # full, or closed
            self.pictures.send(PhonePicture(machine_s, picture.jpeg).encode(), socket.MSG_DONTWAIT)


class Room:
    """A recording that is open at this process."""

    def __init__(self, recording: RecordingSession, relay: RecordingRelay) -> None:
        self.recording, self._relay = recording, relay
        self.phones: dict[int, Side] = {}
        self.hosts: set[HostSide] = set()
        self.live: dict[int, LivePhone] = {}
        self._takers: list[LiveTaker] = []
        self._live_elsewhere: dict[int, tuple[Size, float]] = {}  # with the times at which it was told
        self.num_entered = 0
        self.is_over = False
        self._hosts_elsewhere_s = -_OLD_S

    @property
    def is_relay_away(self) -> bool:
        """Return whether messages to and from other processes get lost at the moment."""
        return self._relay.is_away

    def update(self, recording: RecordingSession) -> None:
        """Take a newer state of the rows, and tell all connections."""
        if recording.revision > self.recording.revision:
            self.replace(recording)

    def replace(self, recording: RecordingSession) -> None:
        """Take a state of the rows, also an earlier one: a database may be restored under the running service."""
        self.recording = recording
        self.wake_all()

    def changed(self, recording: RecordingSession) -> None:
        """Take the state after a change of this process, and tell all connections."""
        self.update(recording)
        self._relay.publish(recording.id, RelayKind.CHANGED)

    def end(self) -> None:
        """End the recording: it was deleted, or its time is over."""
        self.is_over = True
        self.wake_all()

    def wake_all(self) -> None:
        """Wake all sides."""
        for phone in self.phones.values():
            phone.wake.set()
        self.wake_hosts()

    def wake_hosts(self) -> None:
        """Wake the hosts to send the state."""
        for host in self.hosts:
            host.has_news = True
            host.wake.set()

    @contextlib.contextmanager
    def phone_connected(self, number: int, since_s: float, hello: dict[str, Any]) -> Iterator[Side]:
        """Have a phone connected here during the block; an earlier connection of it ends."""
        self._replace(number)
        side = self.phones[number] = Side()
        self.live[number] = LivePhone(True, None, hello, since_s)
        self._tell_phone(number)
        try:
            yield side
        finally:
            if self.phones.get(number) is side:
                del self.phones[number]
                self.live[number].is_connected = False
                self._tell_phone(number)

    def set_status(self, number: int, status: dict[str, Any]) -> None:
        """Take what a phone that is connected here says of itself."""
        self.live[number].status = status
        self._tell_phone(number)

    def show_thumbnail(self, number: int, jpeg: bytes) -> None:
        """Pass a thumbnail on to hosts, in place of an earlier one that was not sent yet."""
        packet = _NUMBER.pack(number) + jpeg
        self._show(number, packet)
        if time.monotonic() < self._hosts_elsewhere_s + _OLD_S:
            self._relay.publish(self.recording.id, RelayKind.THUMBNAIL, number, packet)

    @contextlib.contextmanager
    def taking(self, taker: LiveTaker) -> Iterator[None]:
        """Have pictures of a phone taken during the block."""
        self._takers.append(taker)
        self.tell()
        self.wake_all()
        try:
            yield
        finally:
            self._takers.remove(taker)
            self.wake_all()

    def live_sizes(self) -> dict[int, Size]:
        """Phones whose pictures are taken at the moment, with their calibrated sizes."""
        return self._sizes_elsewhere() | self._sizes_here()

    def _sizes_here(self) -> dict[int, Size]:
        return {taker.phone: taker.size_px for taker in self._takers}

    def _sizes_elsewhere(self) -> dict[int, Size]:
        old_s = time.monotonic() - _OLD_S
        return {number: size_px for number, (size_px, told_s) in self._live_elsewhere.items() if told_s > old_s}

    def take_picture(self, number: int, picture: PhonePicture) -> None:
        """Pass a picture of a phone on to live captures; without any it is dropped."""
        self._pass_on(number, picture)
        if number in self._sizes_elsewhere():
            self._relay.publish(self.recording.id, RelayKind.PICTURE, number, _NUMBER.pack(number) + picture.encode())

    def _pass_on(self, number: int, picture: PhonePicture) -> None:
        for taker in self._takers:
            if taker.phone == number:
                taker.take(picture)

    def received(self, kind: RelayKind, content: bytes) -> None:
        """Take a message of another process; rows are read by the caller."""
        match kind:
            case RelayKind.PHONE:
                told = json.loads(content)
                since_s = told.get("since_s", 0.0)  # none from processes of an earlier version
                phone = LivePhone(told["connected"], told["status"], told["hello"], since_s, time.monotonic())
                self._take_phone(told["phone"], phone)
            case RelayKind.THUMBNAIL:
                self._show(_NUMBER.unpack_from(content)[0], content)
            case RelayKind.HOST:
                self._hosts_elsewhere_s = time.monotonic()
            case RelayKind.LIVE:
                for number, size_px in json.loads(content).items():
                    self._live_elsewhere[int(number)] = (size_px and tuple(size_px), time.monotonic())
                self.wake_all()
            case RelayKind.PICTURE if (picture := PhonePicture.decode(content[_NUMBER.size :])) is not None:
                self._pass_on(_NUMBER.unpack_from(content)[0], picture)

    def tell(self) -> None:
        """Tell other processes who is connected here, and forget what they told long ago."""
        for number in self.phones:
            self._relay.publish(self.recording.id, RelayKind.PHONE, number, self.live[number].encode(number))
        if self.hosts:
            self._relay.publish(self.recording.id, RelayKind.HOST)
        if self._takers:
            self._relay.publish(self.recording.id, RelayKind.LIVE, content=json.dumps(self._sizes_here()).encode())
        for side in self.phones.values():
            side.wake.set()  # a live capture elsewhere may have ended
        old_s = time.monotonic() - _OLD_S
        for number, phone in self.live.items():
            if number not in self.phones and phone.is_connected and phone.told_s < old_s:
                phone.is_connected = False
                self.wake_hosts()

    def _take_phone(self, number: int, phone: LivePhone) -> None:
        """Take what another process told of a phone; of two connections of it the later one stays."""
        if number in self.phones:
            if not phone.is_connected or phone.since_s <= self.live[number].since_s:
                return
            self._replace(number)
        self.live[number] = phone
        self.wake_hosts()

    def _replace(self, number: int) -> None:
        if (earlier := self.phones.pop(number, None)) is not None:
            earlier.is_replaced = True
            earlier.wake.set()

    def _tell_phone(self, number: int) -> None:
        self._relay.publish(self.recording.id, RelayKind.PHONE, number, self.live[number].encode(number))
        self.wake_hosts()

    def _show(self, number: int, packet: bytes) -> None:
        for host in self.hosts:
            host.thumbnails[number] = packet
            host.wake.set()


class Rooms:
    """All rooms of this process."""

    def __init__(self, store: JobStore, relay: RecordingRelay) -> None:
        self._store, self._relay = store, relay
        self._rooms: dict[str, Room] = {}
        self.num_greeting: Counter[str] = Counter()
        self._nudge = asyncio.Event()

    @contextlib.asynccontextmanager
    async def entered(self, records: TenantRecords, recording_id: str) -> AsyncIterator[Room]:
        """Room of a recording during the block; raises ``NotFound`` if the tenant has no such recording."""
        recording = await run_in_threadpool(records.recordings.get, recording_id)
        room = self._rooms.get(recording_id)
        if room is None or room.is_over:
            room = self._rooms[recording_id] = Room(recording, self._relay)
            self._relay.subscribe(recording_id)
        room.update(recording)
        room.num_entered += 1
        self._nudge.set()
        try:
            yield room
        finally:
            room.num_entered -= 1
            if not room.num_entered and self._rooms.get(recording_id) is room:
                del self._rooms[recording_id]
                self._relay.unsubscribe(recording_id)

    @contextlib.contextmanager
    def greeting(self, recording_id: str, max_greeting: int) -> Iterator[None]:
        """Have a connection that has yet to say which phone it is during the block.

        Raises ``SocketProblem`` if ``max_greeting`` others are silent at this process.
        """
        if self.num_greeting[recording_id] >= max_greeting:
            raise SocketProblem(RECORDING_BUSY, "Too many connections have not said hello yet.", LATER)
        self.num_greeting[recording_id] += 1
        try:
            yield
        finally:
            self.num_greeting[recording_id] -= 1
            self.num_greeting += Counter()  # drops counts of zero

    async def run(self) -> None:
        """Keep the rooms up to date until it is canceled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._relay.run(self._received))
            tasks.create_task(self._poll_forever())

    async def refresh(self) -> None:
        """Read what has changed of all rooms."""
        rooms = dict(self._rooms)
        known = {recording_id: room.recording.revision for recording_id, room in rooms.items()}
        revisions = await run_in_threadpool(self._store.recordings.revisions, list(rooms))
        for recording_id, room in rooms.items():
            if recording_id not in revisions:
                room.end()
            elif revisions[recording_id] != room.recording.revision:
                with contextlib.suppress(NotFound):  # it has ended just now
                    recording = await run_in_threadpool(self._store.recordings.get, recording_id)
                    # The rows were read after the known state: an earlier state is in a restored database.
                    is_restored = revisions[recording_id] < known[recording_id]
                    (room.replace if is_restored else room.update)(recording)

    async def _poll_forever(self) -> None:
        tell_s = 0.0
        while True:
            if not self._rooms:
                self._nudge.clear()
                await self._nudge.wait()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_POLL_S):
                    self._nudge.clear()
                    await self._nudge.wait()
            try:
                await self.refresh()
            except Exception:
                _log.exception("recordings_not_read")  # the database may be away for a while
                await asyncio.sleep(_POLL_S)
            if time.monotonic() >= tell_s:
                tell_s = time.monotonic() + _TELL_S
                for room in self._rooms.values():
                    room.tell()

    def _received(self, recording_id: str, kind: RelayKind, content: bytes) -> None:
        if (room := self._rooms.get(recording_id)) is None:
            return
        if kind is RelayKind.CHANGED:
            self._nudge.set()
        else:
            room.received(kind, content)
