"""Room of a recording at two processes whose messages come late, or not at all for a while."""

from collections.abc import Sequence
from datetime import UTC, datetime

import pytest

from api.recordings.relay import RecordingRelay, RelayKind
from api.recordings.rooms import Room
from worker.jobs.model.recordings import RecordingSession

NOW = datetime(2026, 11, 27, tzinfo=UTC)


class SilentRelay(RecordingRelay):
    """Relay to a broker that takes nothing."""

    def __init__(self) -> None:
        super().__init__("redis://127.0.0.1:1/0")


@pytest.mark.parametrize("order", [(0, 1), (1, 0), (0, 1, 0, 1)])
def test_of_two_connections_of_a_phone_the_later_one_stays(order: Sequence[int]) -> None:
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


def test_processes_of_an_earlier_version_end_no_connection() -> None:
    room = Room(RecordingSession("r", "Rehearsal", NOW, NOW, 1), SilentRelay())
    with room.phone_connected(1, 8.0, {}) as side:
        room.received(RelayKind.PHONE, b'{"phone": 1, "connected": true, "status": null, "hello": null}')
        assert not side.is_replaced
