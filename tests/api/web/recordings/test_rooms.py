"""Room of a recording at two processes whose messages come late, or not at all for a while."""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from api.web.recordings.broadcast import RecordingRelay, RelayKind
from api.web.recordings.rooms import Room, Rooms
from worker.store.model.phone_records import RecordingSession
from worker.store.store import JobStore

NOW = datetime(2026, 11, 27, tzinfo=UTC)


class SilentRelay(RecordingRelay):
    """Relay to a broker that takes nothing."""

    def __init__(self) -> None:
        super().__init__("redis://127.0.0.1:1/0")


@pytest.mark.parametrize("order", [(0, 1), (1, 0), (0, 1, 0, 1)])
def test_of_two_connections_of_phone_later_one_stays(order: Sequence[int]) -> None:
    recording = RecordingSession("r", "Rehearsal", NOW, NOW, 1)
    rooms = [Room(recording, SilentRelay()) for _ in range(2)]
    with rooms[0].phone_connected(1, 8.0, {}) as earlier, rooms[1].phone_connected(1, 8.5, {}) as later:
        told = [room.live[1].encode(1) for room in rooms]
        for number in order:  # what one process told reaches the other one
            rooms[1 - number].received(RelayKind.PHONE, told[number])
        assert earlier.is_replaced
        assert not later.is_replaced
        assert all(room.live[1].is_connected for room in rooms)
    assert not rooms[1].live[1].is_connected


def test_database_that_was_restored_is_followed(tmp_path: Path) -> None:
    store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
    store.migrate()
    records = store.tenant("default")
    recording, _ = records.recordings.add("Rehearsal", 3600.0)
    rooms = Rooms(store, SilentRelay())

    async def follow() -> None:
        async with rooms.entered(records, recording.id) as room:
            room.update(replace(recording, name="Before the restore", revision=recording.revision + 20))
            with room.phone_connected(1, 8.0, {}) as phone:
                phone.wake.clear()
                await rooms.refresh()
                assert room.recording == recording
                assert phone.wake.is_set()

    asyncio.run(follow())
    store.close()


def test_processes_of_earlier_version_end_no_connection() -> None:
    room = Room(RecordingSession("r", "Rehearsal", NOW, NOW, 1), SilentRelay())
    with room.phone_connected(1, 8.0, {}) as side:
        room.received(RelayKind.PHONE, b'{"phone": 1, "connected": true, "status": null, "hello": null}')
        assert not side.is_replaced
