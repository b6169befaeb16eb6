"""Hosts and phones of recordings, as clients of a running service."""

import base64
import contextlib
import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import httpx2
import pytest
import websockets.sync.client

from api.web.settings import Settings
from tests.api.conftest import Live, running

# Start of an image, a comment, and a frame of 180 x 240 pixels.
JPEG = b"\xff\xd8" + b"\xff\xfe\x00\x04ab" + b"\xff\xc0\x00\x11\x08\x00\xb4\x00\xf0\x03" + bytes(100)
TUS = {"Tus-Resumable": "1.0.0", "Content-Type": "application/offset+octet-stream"}
# First frames of phones, by the service's clock, after the start of a take.
STARTED_LATE_S = 0.0125


@pytest.fixture(scope="session")
def rooms_service(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Running service with low limits, without a broker."""
    settings = make_settings(
        max_recording_phones=3,
        max_recording_hosts=2,
        max_recording_takes=4,
        max_recording_uploads=5,
        max_recording_bytes=50_000,
        max_recording_messages_per_s=200.0,
        max_wrong_keys_per_minute=100_000,
        max_json_bytes=4_000,
        recording_idle_s=20.0,
    )
    with running(settings) as live:
        yield live


@dataclass
class OpenedRecording:
    """A recording that was opened, and the secret of its link."""

    live: Live
    id: str
    secret: str
    headers: dict[str, str] = field(default_factory=dict)

    def read(self) -> dict[str, Any]:
        answer = self.live.client.get(f"/v1/recordings/{self.id}", headers=self.headers)
        assert answer.status_code == 200, answer.text
        document: dict[str, Any] = answer.json()
        return document

    def phone(self, name: str | None = None, **options: Any) -> AbstractContextManager["PhoneSocket"]:
        return connected_phone(self, name, **options)

    def host(self) -> AbstractContextManager["RoomSocket"]:
        return connected_host(self)


def opened_recording(live: Live, headers: dict[str, str] | None = None, **spec: Any) -> OpenedRecording:
    answer = live.client.post("/v1/recordings", json=spec, headers=headers or {})
    assert answer.status_code == 201, answer.text
    return OpenedRecording(live, answer.json()["id"], answer.json()["join"]["secret"], headers or {})


@pytest.fixture
def recording(rooms_service: Live) -> Iterator[OpenedRecording]:
    opened = opened_recording(rooms_service)
    yield opened
    rooms_service.client.delete(f"/v1/recordings/{opened.id}")


class RoomSocket:
    """WebSocket of a recording: sends and receives JSON."""

    def __init__(self, socket: websockets.sync.client.ClientConnection) -> None:
        self.socket = socket

    def send(self, kind: str, **fields: Any) -> None:
        self.socket.send(json.dumps({"type": kind, **fields}))

    def message(self, timeout_s: float = 30.0) -> Any:
        message = self.socket.recv(timeout_s)
        return json.loads(message) if isinstance(message, str) else message

    def next(self, kind: str, timeout_s: float = 30.0) -> dict[str, Any]:
        """Next message of a type; others are passed over."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            message = self.message(max(0.0, deadline_s - time.monotonic()))
            if isinstance(message, dict) and message["type"] == kind:
                return message

    def state(self, holds: Callable[[dict[str, Any]], object], timeout_s: float = 30.0) -> dict[str, Any]:
        """Next state of a host for which something holds; of the recording the last one that was sent."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            message = self.next("state", max(0.0, deadline_s - time.monotonic()))
            if message["recording"] is not None:
                self.recording = message["recording"]
            message["recording"] = self.recording
            if holds(message):
                return message

    def thumbnail(self, timeout_s: float = 30.0) -> bytes:
        deadline_s = time.monotonic() + timeout_s
        while True:
            message = self.socket.recv(max(0.0, deadline_s - time.monotonic()))
            if isinstance(message, bytes):
                return message

    def problem(self) -> dict[str, Any]:
        """Problem that ends the connection, with its close code."""
        problem = self.next("problem")
        assert "Traceback" not in json.dumps(problem)
        with pytest.raises(websockets.ConnectionClosed):
            self._drain()
        assert self.socket.close_code == problem["close_code"]
        return problem

    def ended(self) -> str:
        """Reason of the end that is no problem."""
        reason = str(self.next("ended")["reason"])
        with pytest.raises(websockets.ConnectionClosedOK):
            self._drain()
        return reason

    def _drain(self) -> None:
        while True:
            self.socket.recv(30.0)


class PhoneSocket(RoomSocket):
    """WebSocket of a phone that was welcomed; uploads too."""

    def __init__(
        self, socket: websockets.sync.client.ClientConnection, recording: OpenedRecording, phone_id: str
    ) -> None:
        super().__init__(socket)
        self._recording, self.phone_id = recording, phone_id
        self.welcome: dict[str, Any] = {}

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self._recording.secret}", "Multicap-Phone": self.phone_id}

    def begin_upload(self, num_bytes: int, **headers: str) -> httpx2.Response:
        name = base64.b64encode(b"take.webm").decode()
        sent = {
            "Upload-Length": str(num_bytes),
            "Upload-Metadata": f"filename {name}",
            **TUS,
            **self.headers,
            **headers,
        }
        return self._recording.live.client.post("/v1/uploads", headers=sent)

    def upload(self, content: bytes) -> str:
        """Send a file by tus; return the upload's id."""
        begun = self.begin_upload(len(content))
        assert begun.status_code == 201, begun.text
        sent = {"Upload-Offset": "0", **TUS, **self.headers}
        answer = self._recording.live.client.patch(begun.headers["location"], content=content, headers=sent)
        assert answer.status_code == 204, answer.text
        return str(begun.headers["location"].rpartition("/")[2])

    def record(self, take: int, start_s: float, content: bytes = b"video", **facts: Any) -> str:
        """Record a take and upload it, without waiting for its times; return the upload's id."""
        first_s = start_s + STARTED_LATE_S
        self.send("started", take=take, first_frame_s=first_s, std_s=0.002)
        self.send("stopped", take=take, num_bytes=len(content), num_frames=60)
        upload_id = self.upload(content)
        self.send("file", **file_fields(take, upload_id, first_s, len(content)) | facts)
        return upload_id


def file_fields(take: int, upload_id: str, first_frame_s: float, num_bytes: int = 5) -> dict[str, Any]:
    times = {"first_frame_s": first_frame_s, "std_s": 0.002, "duration_s": 2.4}
    return {"take": take, "upload_id": upload_id, "num_bytes": num_bytes, "mime_type": "video/webm;codecs=vp9", **times}


def address_of(recording: OpenedRecording) -> str:
    host, port = recording.live.address[:2]
    return f"ws://{host}:{port}/v1/recordings/{recording.id}/connect"


def socket_of(
    recording: OpenedRecording, **options: Any
) -> AbstractContextManager[websockets.sync.client.ClientConnection]:
    """WebSocket to a recording; options as of the library."""
    limits: dict[str, Any] = {"max_size": None, "open_timeout": 60, "close_timeout": 10}
    return websockets.sync.client.connect(address_of(recording), **(limits | options))


@contextlib.contextmanager
def connected_phone(
    recording: OpenedRecording, name: str | None = None, phone_id: str | None = None, **hello: Any
) -> Iterator[PhoneSocket]:
    """Phone that has joined by the subprotocols that browsers offer, and was welcomed."""
    offered = ["multicap.recording", f"mc.link.{recording.secret}"]
    identity = phone_id or f"phone-id-of-a-test-{time.monotonic_ns()}"
    with socket_of(recording, subprotocols=offered) as socket:
        assert socket.subprotocol == "multicap.recording"
        phone = PhoneSocket(socket, recording, identity)
        phone.send("hello", phone_id=identity, **({"name": name} if name else {}), **hello)
        phone.welcome = phone.next("welcome")
        yield phone


@contextlib.contextmanager
def connected_host(recording: OpenedRecording) -> Iterator[RoomSocket]:
    with socket_of(recording, additional_headers=recording.headers) as socket:
        yield RoomSocket(socket)


def taken(host: RoomSocket) -> dict[str, Any]:
    """Start and stop a take; return it as hosts see it."""
    num_takes = len(host.state(lambda state: True)["recording"]["takes"])
    host.send("start")
    host.state(lambda state: len(state["recording"]["takes"]) == num_takes + 1)
    host.send("stop")
    state = host.state(lambda state: state["recording"]["takes"][-1]["state"] == "recorded")
    take: dict[str, Any] = state["recording"]["takes"][-1]
    return take
