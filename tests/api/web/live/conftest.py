"""The service with small programs in place of the computation of live captures, and of the check of files."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest
import websockets.sync.client

from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.web.live.messages import start_message

# Programs of a server of forks: ``calibration`` finds the cameras of a calibration, ``capture`` answers each packet
# by an instant with nobody; times choose the behaviour.
SERVER = """
import json, struct, sys, time
from pipeline.core.runtime.forks import serve

def calibration(arguments):
    cameras = json.load(open(arguments[arguments.index("--calibration") + 1]))["cameras"]
    if not cameras:
        problem = {"code": "calibration_empty", "message": "No cameras.", "file": "sent.json", "camera": None,
                   "field": "cameras", "hint": None}
        print(json.dumps({"problems": [problem]}))
        return 2
    print(json.dumps({"format": "multicap", "units": "m", "axes": "Z up", "warnings": [],
                      "text": json.dumps({"cameras": cameras})}))
    return 0

def answer(kind, content):
    sys.stdout.buffer.write(struct.pack("<I", len(content) + 1) + kind + content)
    sys.stdout.buffer.flush()

def capture(arguments):
    cameras = None
    taken, sequence = 0, 0
    while (length := sys.stdin.buffer.read(4)):
        packet = sys.stdin.buffer.read(struct.unpack("<I", length)[0])
        if cameras is None:
            start = json.loads(packet)
            cameras = [camera["name"] for camera in json.load(open(start["calibration"]))["cameras"]]
            if start["settings"]["learn_s"] == 59.0:
                problem = {"code": "parameter_range", "message": "No.", "field": "learn_s", "camera": None}
                answer(b"P", json.dumps([problem]).encode())
                return 2
            ready = {"cameras": cameras, "joints": ["nose"], "bones": ["Hips"], "parents": [None], "rig": []}
            answer(b"R", json.dumps(ready).encode())
            continue
        counts = lambda: json.dumps({"taken": taken, "late": 0, "dropped": 0}).encode()
        if not packet:
            answer(b"E", counts())
            break
        time_s = struct.unpack_from("<d", packet, 12)[0]
        if time_s == 666.0:
            raise RuntimeError("a secret")
        if time_s == 999.0:
            time.sleep(3600)
        if time_s >= 100.0 and time_s < 200.0:
            time.sleep(0.05)
        taken += 1
        if start["format"] == "packed":
            answer(b"I", struct.pack("<4sHHHHdfIII", b"MCI1", 0, 1, 1, 0, time_s, 0.5, sequence, 0, 0))
        else:
            filling = "x" * 200_000 if 200.0 <= time_s < 300.0 else ""
            instant = {"sequence": sequence, "time_s": time_s, "lag_s": 0.5, "people": [], "filling": filling}
            answer(b"I", json.dumps(instant).encode())
        sequence += 1
        answer(b"T", counts())
    return 0

serve({"calibration": calibration, "capture": capture})
"""


@pytest.fixture(scope="session")
def live_commands(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, ...]]:
    """Settings with a program in place of the server from which captures are forked."""
    path: Path = tmp_path_factory.mktemp("live") / "server.py"
    path.write_text(SERVER, encoding="utf-8")
    return {"live_command": (sys.executable, "-P", str(path))}


@pytest.fixture(scope="session")
def live_service(make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]) -> Iterator[Live]:
    """Running service with low limits."""
    settings = make_settings(
        **live_commands,
        max_live_captures=12,
        max_tenant_live_captures=12,
        max_live_message_bytes=100_000,
        max_live_people=8,
        max_bad_live_captures_per_minute=1000,
        live_answer_s=3.0,
        live_idle_s=20.0,
    )
    with running(settings) as live:
        yield live


class LiveSocket:
    """WebSocket of a test: sends and receives JSON."""

    def __init__(self, socket: websockets.sync.client.ClientConnection) -> None:
        self.socket = socket

    def send(self, message: Any) -> None:
        self.socket.send(message if isinstance(message, str | bytes) else json.dumps(message))

    def receive(self, timeout_s: float = 60.0) -> Any:
        message = self.socket.recv(timeout_s)
        return json.loads(message) if isinstance(message, str) else message

    def start(self, **changes: Any) -> Any:
        self.send(start_message(**changes))
        return self.receive()

    def problem(self) -> dict[str, Any]:
        """Problem that comes, behind any instants, and the close code, which agree."""
        while (message := self.receive())["type"] == "instant":
            pass
        assert message["type"] == "problem", message
        assert "Traceback" not in json.dumps(message)
        assert "secret" not in json.dumps(message)
        with pytest.raises(websockets.ConnectionClosed):
            self.socket.recv(60.0)
        assert self.socket.close_code == message["close_code"]
        return message

    def ended(self) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        """Instants until the end, and the message of the end; the connection is closed as it should be."""
        self.send({"type": "end"})
        instants = []
        while (message := self.receive())["type"] == "instant":
            instants.append(message)
        assert message["type"] == "ended", message
        with pytest.raises(websockets.ConnectionClosedOK):
            self.socket.recv(60.0)
        return instants, message


def opened(service: Live, **options: Any) -> AbstractContextManager[websockets.sync.client.ClientConnection]:
    """WebSocket to the service; options as of the library."""
    address = f"ws://127.0.0.1:{service.address[1]}/v1/live"
    return websockets.sync.client.connect(address, max_size=None, open_timeout=60, close_timeout=20, **options)


@pytest.fixture
def live_socket(live_service: Live) -> Iterator[LiveSocket]:
    with opened(live_service) as socket:
        yield LiveSocket(socket)
