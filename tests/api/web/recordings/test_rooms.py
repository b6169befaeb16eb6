"""Room of a recording at two processes whose messages come late, or not at all for a while."""

import asyncio
import socket
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from api.web.recordings import rooms
from api.web.recordings.broadcast import RecordingRelay, RelayKind
from api.web.recordings.rooms import LiveTaker, Room, Rooms
from pipeline.run.live.packets import PhonePicture
from worker.store.model.phone_records import RecordingSession
from worker.store.store import JobStore

NOW = datetime(2026, 11, 27, tzinfo=UTC)


class SilentRelay(RecordingRelay):
    """Relay to a broker that takes nothing."""

    def __init__(self) -> None:
        super().__init__("redis://127.0.0.1:1/0")


class DirectRelay(SilentRelay):
    """Relay whose messages reach other rooms at once."""

    def __init__(self) -> None:
        super().__init__()
        self.others: list[Room] = []

    def publish(self, recording_id: str, kind: RelayKind, phone: int = 0, content: bytes = b"") -> None:
        for room in self.others:
            room.received(kind, content)


def test_pictures_of_phone_reach_live_capture_of_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    relays = DirectRelay(), DirectRelay()
    here, there = (Room(RecordingSession("r", "Rehearsal", NOW, NOW, 1), relay) for relay in relays)
    relays[0].others, relays[1].others = [there], [here]
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs, there.phone_connected(1, 8.0, {}) as phone:
        phone.wake.clear()
        there.take_picture(1, PhonePicture(time.time(), b"before"))
        with here.taking(LiveTaker(1, (1920, 1080), ours)):
            assert phone.wake.is_set()
            assert there.live_sizes() == here.live_sizes() == {1: (1920, 1080)}
            there.take_picture(1, PhonePicture(time.time() - 3.0, b"first"))
            there.take_picture(2, PhonePicture(time.time(), b"of another phone"))
            picture = PhonePicture.decode(theirs.recv(100))
            assert picture is not None
            assert picture.jpeg == b"first"
            assert time.monotonic() - picture.time_s == pytest.approx(3.0, abs=1.0)
            for _ in range(100):  # no process takes them: none waits, and nothing is held up
                there.take_picture(1, PhonePicture(time.time(), bytes(100_000)))
        phone.wake.clear()
        monkeypatch.setattr(rooms, "_OLD_S", -1.0)
        there.tell()
        assert phone.wake.is_set()
        assert there.live_sizes() == here.live_sizes() == {}


@pytest.mark.parametrize("order", [(0, 1), (1, 0), (0, 1, 0, 1)])
def test_of_two_connections_of_phone_later_one_stays(order: Sequence[int]) -> None:
    recording = RecordingSession("r", "Rehearsal", NOW, NOW, 1)
    both = [Room(recording, SilentRelay()) for _ in range(2)]
    with both[0].phone_connected(1, 8.0, {}) as earlier, both[1].phone_connected(1, 8.5, {}) as later:
        told = [room.live[1].encode(1) for room in both]
        for number in order:  # what one process told reaches the other one
            both[1 - number].received(RelayKind.PHONE, told[number])
        assert earlier.is_replaced
        assert not later.is_replaced
        assert all(room.live[1].is_connected for room in both)
    assert not both[1].live[1].is_connected


def test_database_that_was_restored_is_followed(tmp_path: Path) -> None:
    store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
    store.migrate()
    records = store.tenant("default")
    recording, _ = records.recordings.add("Rehearsal", 3600.0)
    all_rooms = Rooms(store, SilentRelay())

    async def follow() -> None:
        async with all_rooms.entered(records, recording.id) as room:
            room.update(replace(recording, name="Before the restore", revision=recording.revision + 20))
            with room.phone_connected(1, 8.0, {}) as phone:
                phone.wake.clear()
                await all_rooms.refresh()
                assert room.recording == recording
                assert phone.wake.is_set()

    asyncio.run(follow())
    store.close()


def test_processes_of_earlier_version_end_no_connection() -> None:
    room = Room(RecordingSession("r", "Rehearsal", NOW, NOW, 1), SilentRelay())
    with room.phone_connected(1, 8.0, {}) as side:
        room.received(RelayKind.PHONE, b'{"phone": 1, "connected": true, "status": null, "hello": null}')
        assert not side.is_replaced
