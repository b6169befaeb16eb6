"""Bad days of operators: a full disk while captures are kept, a service that is stopped."""

import asyncio
import errno
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import websockets

from api.web.dependencies import Services
from api.web.live import keeping
from api.web.live.keeping import KeptPackets
from api.web.settings import Settings
from multicap.live import LiveError, LiveOptions, connect_sync
from pipeline.run.live.keeping import write_session
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import CALIBRATION, packet
from tests.waiting import wait_for
from worker.store.files.disk import DiskSpace


class SmallRoom(DiskSpace):
    """Disk that has room for some bytes more."""

    def __init__(self, folder: Path, left_bytes: int) -> None:
        super().__init__(folder)
        self.left_bytes = left_bytes

    def require_room(self, num_bytes: int = 0) -> None:
        if num_bytes > self.left_bytes:
            raise OSError(errno.ENOSPC, "full")
        self.left_bytes -= num_bytes


def test_packets_kept_before_full_disk_stay(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, make_settings: Callable[..., Settings]
) -> None:
    monkeypatch.setattr(keeping, "_BLOCK_BYTES", 2 * len(packet()) + 8)  # blocks of two frames
    disk = SmallRoom(tmp_path, 7 * len(packet()))
    services = cast(Services, SimpleNamespace(disk=disk, settings=make_settings()))
    kept = KeptPackets(services, tmp_path, "coco-17")

    async def run() -> None:
        for number in range(12):
            await kept.add(packet(number % 2, time_s=number / 25))

    asyncio.run(run())
    assert kept.num_frames == 6
    with kept.path.open("rb") as packets:
        names = write_session(packets, tmp_path, ("left", "right"), "coco-17")
    rows = (tmp_path / "timestamps.csv").read_text().splitlines()
    assert (sorted(names), len(rows)) == (["left", "right"], 1 + 6)


def test_full_disk_at_end_is_problem_and_leaves_nothing(
    live_service: Live, live_socket: LiveSocket, monkeypatch: pytest.MonkeyPatch
) -> None:
    live_socket.start(keep=True)
    live_socket.send(packet())
    live_socket.receive()
    monkeypatch.setattr(live_service.services.disk, "_headroom_bytes", 2**60)
    live_socket.send({"type": "end"})
    problem = live_socket.problem()
    assert (problem["code"], problem["close_code"], problem["retryable"]) == ("storage_full", 1013, True)
    wait_for(lambda: not any(live_service.settings.spool_dir.rglob("packets")))


def test_service_that_is_stopped_says_so_and_keeps_nothing(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    settings = make_settings(**live_commands)
    stop = threading.Event()
    addresses: list[Any] = []

    def serve() -> None:
        with running(settings) as live:
            addresses.append(live)
            stop.wait(60)

    service = threading.Thread(target=serve)
    service.start()
    wait_for(lambda: bool(addresses))
    live = addresses[0]
    url = f"http://127.0.0.1:{live.address[1]}"
    with opened(live) as connection, connect_sync(url, CALIBRATION, "coco-17", 25.0, LiveOptions(keep=True)) as capture:
        client = LiveSocket(connection)
        client.start(keep=True)
        client.send(packet())
        client.receive()
        stop.set()
        with pytest.raises(websockets.ConnectionClosed) as closed:
            client.receive()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1012
        with pytest.raises(LiveError, match="live_stopped"):
            capture.receive()
    service.join(60)
    assert not service.is_alive()
    assert not any(settings.spool_dir.iterdir())
