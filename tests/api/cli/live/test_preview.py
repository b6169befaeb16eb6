"""Preview of a live capture: what a browser gets, and who is refused."""

import json
import socket
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx2
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from api.cli.live.preview import PreviewPage
from pipeline.core.errors import InputError
from pipeline.run.live.cameras.totals import CameraTotals, LiveTotals
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.packing import unpack_instant
from pipeline.run.live.records import recorded_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.simulation.scenes import SCENES, Simulation, record

RATE_HZ = 25.0


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=0.6), 0, 3)


@pytest.fixture
def page(room: Simulation) -> Iterator[PreviewPage]:
    with PreviewPage(0) as preview:
        preview.begin(room.cameras, room.joints, RATE_HZ)
        yield preview


def address(page: PreviewPage) -> str:
    return page.url.replace("http:", "ws:") + "live"


def test_preview_browser_gets_people_and_figures(room: Simulation, page: PreviewPage) -> None:
    totals = LiveTotals([CameraTotals("cam_00", "lost", decoded=20, detected=12, lost=1)])
    with connect(address(page)) as browser:
        ready = json.loads(browser.recv(10))
        assert (ready["type"], ready["joints"]) == ("ready", list(room.joints.names))
        assert [camera["name"] for camera in ready["rig"]] == [camera.name for camera in room.cameras]
        capture = LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ))
        for frame in recorded_frames(room.cameras, room.times, room.detections)[:30]:
            for instant in capture.push(*frame):
                page.show(instant, 0.08)
                sent, _ = unpack_instant(browser.recv(10))  # type: ignore[arg-type]
                assert (sent.time_s, len(sent.people)) == (instant.time_s, len(instant.people))
        page.tick(totals)
        status: dict[str, Any] = json.loads(browser.recv(10))
        assert status["latency_s"] == pytest.approx({"p50": 0.08, "p95": 0.08})
        assert status["cameras"] == [
            {"name": "cam_00", "state": "lost", "decoded_hz": 20, "detected_hz": 12, "dropped": 8, "lost": 1}
        ]
        totals.cameras[0].decoded += 25
        page.tick(totals)
        assert json.loads(browser.recv(10))["cameras"][0]["decoded_hz"] == 25


def test_other_pages_and_hosts_are_refused(page: PreviewPage) -> None:
    with httpx2.Client(base_url=page.url, trust_env=False) as client:
        answer = client.get("/")
        assert "preview.js" in answer.text
        assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert client.get("/portal/live/preview.js").status_code == 200
        assert client.get("/", headers={"Host": "evil.example"}).status_code == 403
    with pytest.raises(InvalidStatus), connect(address(page), origin=Origin("http://evil.example")):
        pass


def test_preview_slow_browser_delays_no_other(room: Simulation, page: PreviewPage) -> None:
    capture = LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ))
    frames = recorded_frames(room.cameras, room.times, room.detections)
    instants = [instant for frame in frames for instant in capture.push(*frame)]
    with connect(address(page), max_queue=1) as browser:
        browser.recv(10)
        for _ in range(2000):
            page.show(instants[-1], 0.0)


def test_port_taken_is_problem(page: PreviewPage) -> None:
    port = int(page.url.rstrip("/").rpartition(":")[2])
    with pytest.raises(InputError, match="can't be used"):
        PreviewPage(port)


def test_preview_browser_messages_are_limited(room: Simulation, page: PreviewPage) -> None:
    with connect(address(page)) as browser, connect(address(page)) as other:
        browser.recv(10)
        other.recv(10)
        browser.send(bytes(100_000))
        with pytest.raises(ConnectionClosed) as closed:
            browser.recv(10)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009
        page.tick(LiveTotals([]))
        assert json.loads(other.recv(10))["type"] == "status"


def test_pages_under_another_name_are_refused(page: PreviewPage) -> None:
    """A name of a stranger that leads to this machine (DNS rebinding), and pages of other ports."""
    port = page.url.rstrip("/").rpartition(":")[2]
    for headers in (
        {"Host": f"rebound.example:{port}", "Origin": f"http://rebound.example:{port}"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "null"},
        {"Host": ""},
    ):
        given = {"Host": f"127.0.0.1:{port}"} | headers
        lines = ["GET /live HTTP/1.1", *(f"{name}: {value}" for name, value in given.items())]
        lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", "", ""]
        with socket.create_connection(("127.0.0.1", int(port)), 10) as connection:
            connection.sendall("\r\n".join(lines).encode())
            assert connection.recv(1000).split()[1] in {b"403", b"400"}
