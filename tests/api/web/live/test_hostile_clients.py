"""Broken and hostile clients of live captures, beside good ones that get all of their instants."""

import threading
import time
from collections.abc import Callable, Iterator

import psutil
import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.hostile_clients import attack_by
from tests.api.web.live.messages import packet, start_message

NUM_FRAMES = 200
NUM_GOOD = 2
# Much more than the process of the tests grows by, much less than unread messages would take.
MAX_GROWTH_BYTES = 400 * 2**20


@pytest.fixture(scope="module")
def crowded(make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]) -> Iterator[Live]:
    """Running service with room for a few captures, and short patience."""
    settings = make_settings(
        **live_commands,
        max_live_captures=8,
        max_tenant_live_captures=8,
        max_live_message_bytes=100_000,
        live_idle_s=5.0,
        live_answer_s=3.0,
        max_live_messages_per_s=500.0,
        max_bad_live_captures_per_minute=1000,
    )
    with running(settings) as live:
        yield live


def capture_well(service: Live, hostile: threading.Barrier, results: list[tuple[int, int]]) -> None:
    with opened(service) as connection:
        client = LiveSocket(connection)
        client.start()
        hostile.wait(60)
        for number in range(NUM_FRAMES):
            client.send(packet(time_s=number * 0.02))
            time.sleep(0.02)
        instants, end = client.ended()
        results.append((len(instants), sum(end["dropped"].values())))


def disturbed(service: Live, num_hostile: int) -> list[tuple[int, int]]:
    """Numbers of instants and of dropped messages of the good clients, among hostile ones."""
    barrier = threading.Barrier(NUM_GOOD + 1)
    results: list[tuple[int, int]] = []
    good = [threading.Thread(target=capture_well, args=(service, barrier, results)) for _ in range(NUM_GOOD)]
    for thread in good:
        thread.start()
    barrier.wait(60)
    bad = attack_by(f"ws://127.0.0.1:{service.address[1]}/v1/live", start_message(), num_hostile)
    for thread in (*good, *bad):
        thread.join(120)
        assert not thread.is_alive()
    return results


@pytest.mark.parametrize("num_hostile", [8, pytest.param(100, marks=pytest.mark.slow)])
def test_good_clients_are_undisturbed(crowded: Live, num_hostile: int) -> None:
    process = psutil.Process()
    before = process.memory_info().rss
    assert disturbed(crowded, num_hostile) == [(NUM_FRAMES, 0)] * NUM_GOOD
    assert process.memory_info().rss - before < MAX_GROWTH_BYTES
    # Nothing is left: no process, no file, no place.
    deadline_s = time.monotonic() + 60
    while left_behind(crowded) and time.monotonic() < deadline_s:
        time.sleep(0.1)
    assert left_behind(crowded) == []
    with opened(crowded) as connection:
        client = LiveSocket(connection)
        client.start()
        client.send(packet())
        assert len(client.ended()[0]) == 1


def left_behind(service: Live) -> list[str]:
    """Processes of captures, and files of theirs."""
    server = psutil.Process(service.services.live_forks.pid)
    return [*map(str, server.children(recursive=True)), *map(str, service.settings.spool_dir.rglob("*"))]
