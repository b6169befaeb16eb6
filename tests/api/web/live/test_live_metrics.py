"""Metrics of live captures, and the backlog that counts what it drops."""

import asyncio

import pytest
import websockets

from api.web.live.backlog import Backlog, Waiting
from tests.api.conftest import Live
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import packet
from tests.api.web.test_metrics import samples
from tests.waiting import wait_for


def value(live: Live, name: str, **labels: str) -> float:
    return samples(live).get((f"multicap_live_{name}", tuple(sorted(labels.items()))), 0.0)


def test_captures_are_counted(live_service: Live, live_socket: LiveSocket) -> None:
    names = ("frames_total", "instants_total", "latency_seconds_count", "latency_seconds_sum")
    before = {name: value(live_service, name) for name in names}
    quick = value(live_service, "latency_seconds_bucket", le="0.03")
    ended = value(live_service, "captures_ended_total", code="ended")
    is_open = value(live_service, "captures")
    live_socket.start()
    assert value(live_service, "captures") == is_open
    live_socket.send(packet(time_s=150.0))  # the program takes 50 ms for it
    live_socket.ended()
    wait_for(lambda: value(live_service, "captures_ended_total", code="ended") == ended + 1)
    assert value(live_service, "captures") == is_open - 1
    grown = {name: value(live_service, name) - before[name] for name in names}
    assert grown["latency_seconds_sum"] >= 0.05
    assert [grown[name] for name in names[:3]] == [1, 1, 1]
    assert value(live_service, "latency_seconds_bucket", le="0.03") == quick


def test_refusals_and_problems_are_counted_by_their_codes(live_service: Live) -> None:
    wrong = value(live_service, "captures_ended_total", code="live_message")
    refused = value(live_service, "captures_refused_total", code="key_required")
    with opened(live_service) as connection:
        client = LiveSocket(connection)
        client.send("nonsense")
        client.problem()
    wait_for(lambda: value(live_service, "captures_ended_total", code="live_message") == wrong + 1)
    headers = {"Authorization": "Bearer mc_wrong"}
    with pytest.raises(websockets.InvalidStatus), opened(live_service, additional_headers=headers):
        pass
    assert value(live_service, "captures_refused_total", code="key_required") == refused + 1


def test_backlog_drops_oldest_messages_and_says_how_many() -> None:
    dropped: list[int] = []

    async def run() -> list[Waiting]:
        backlog = Backlog(3, 100, dropped.append)
        for number in range(5):
            backlog.put(bytes(10), float(number))
        backlog.put(bytes(80), 5.0)
        backlog.close()
        return [message async for message in backlog.taken()]

    assert [message.since_s for message in asyncio.run(run())] == [3.0, 4.0, 5.0]
    assert dropped == [1, 1, 1]
