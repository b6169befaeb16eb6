"""Phones of recordings as cameras of live captures: what they are told, and which of their pictures come."""

import json
import struct
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import CAMERA_PROGRAM
from tests.api.web.recordings.conftest import JPEG, OpenedRecording, PhoneSocket, connected_phone, opened_recording
from worker.store.model.rights import Scope

# Program in the place of the one that opens cameras: it tells of each picture that comes.
PROGRAM = (
    CAMERA_PROGRAM
    + """names = [source["camera"] for source in start["sources"]]
answer(b"R", {"type": "ready", "cameras": names, "joints": ["nose"], "bones": ["Hips"], "parents": [None],
              "rig": [], "frame_rate_hz": 12.5, "layout": "coco-17"})
sockets = {socket.socket(fileno=source["pictures"]): source["camera"] for source in start["sources"]}
number = 0
while True:
    ready, _, _ = select.select([sys.stdin, *sockets], [], [])
    if sys.stdin in ready:
        break
    for one in ready:
        packet = one.recv(2**18)
        age_s = time.monotonic() - struct.unpack_from("<d", packet, 4)[0]
        answer(b"S", {"type": "notice", "message": json.dumps([sockets[one], round(age_s), packet[12:].hex()])})
        number += 1
answer(b"E", {"received": number, "taken": number, "late": 0, "dropped": 0})
"""
)
CALIBRATION = {"cameras": [{"name": "Left", "size_px": [1920, 1080]}, {"name": "Right", "size_px": None}]}
SHORT = JPEG[:40]


@pytest.fixture(scope="module")
def service(
    make_settings: Callable[..., Settings],
    live_commands: dict[str, tuple[str, ...]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Live]:
    """Running service with the small program, and with low limits of phones."""
    path: Path = tmp_path_factory.mktemp("phones") / "program.py"
    path.write_text(PROGRAM, encoding="utf-8")
    limits = {"max_phone_picture_bytes": 40_000, "max_phone_pictures_per_s": 5.0, "max_recording_messages_per_s": 200.0}
    command = (sys.executable, "-P", str(path))
    with running(make_settings(**live_commands, **limits, live_cameras_command=command)) as live:
        yield live


def packet(jpeg: bytes, age_s: float = 0.0) -> bytes:
    return b"MCP1" + struct.pack("<d", time.time() - age_s) + jpeg


def start_message(*sources: str) -> dict[str, Any]:
    cameras = [{"camera": name, "source": source} for name, source in zip(("Left", "Right"), sources, strict=True)]
    return {"type": "start_cameras", "calibration": CALIBRATION, "cameras": cameras}


def phone_sources(recording: OpenedRecording) -> list[str]:
    return [f"phone://{recording.id}/{number}" for number in (1, 2)]


def told(client: LiveSocket) -> list[Any]:
    """Camera, age in whole seconds and bytes of the next picture that came."""
    camera, age_s, content = json.loads(client.receive()["message"])
    return [camera, age_s, bytes.fromhex(content)]


def live_of(phone: PhoneSocket) -> tuple[bool, list[int] | None]:
    message = phone.next("live")
    return message["is_on"], message["size_px"]


def test_phones_send_while_capture_runs(service: Live) -> None:
    recording = opened_recording(service)
    with recording.phone("Left") as left, recording.phone("Right") as right:
        assert left.welcome["limits"]["picture_bytes"] == 40_000
        left.socket.send(packet(SHORT))  # unasked: of a capture that has just ended
        with opened(service) as connection:
            client = LiveSocket(connection)
            client.send(start_message(*phone_sources(recording)))
            assert client.receive()["type"] == "ready"
            assert live_of(left) == (True, [1920, 1080])
            assert live_of(right) == (True, None)
            left.socket.send(packet(SHORT, age_s=7.0))
            assert told(client) == ["Left", 7, SHORT]
            right.socket.send(packet(SHORT + b"r"))
            assert told(client) == ["Right", 0, SHORT + b"r"]
            client.send({"type": "end"})
            assert client.receive()["counts"]["received"] == 2
        assert live_of(left) == (False, None)
        left.socket.send(packet(SHORT))
        left.send("ping", t0_s=1.0)
        assert left.next("pong")["t0_s"] == 1.0  # it is still welcome


def test_phone_that_leaves_and_returns_sends_again(service: Live) -> None:
    recording, identity = opened_recording(service), "a-phone-that-leaves-and-returns"
    with (
        recording.phone("Right") as right,
        connected_phone(recording, "Left", phone_id=identity) as left,
        opened(service) as connection,
    ):
        client = LiveSocket(connection)
        client.send(start_message(*reversed(phone_sources(recording))))
        client.receive()
        assert live_of(left)[0]
        left.socket.close()
        right.socket.send(packet(SHORT))
        assert told(client)[0] == "Right"
        with connected_phone(recording, phone_id=identity) as again:
            assert live_of(again) == (True, [1920, 1080])
            again.socket.send(packet(SHORT))
            assert told(client) == ["Left", 0, SHORT]
        client.send({"type": "end"})
        assert client.receive()["type"] == "ended"


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (packet(JPEG + bytes(40_000)), "recording_too_large"),
        (packet(b"GIF89a"), "recording_thumbnail"),
        (packet(JPEG.replace(b"\x00\xf0", b"\x04\x01")), "recording_thumbnail"),
        (b"MCP1" + struct.pack("<d", float("nan")) + JPEG, "recording_thumbnail"),
        (b"MCP1" + bytes(3), "recording_thumbnail"),
        (JPEG + bytes(30_000), "recording_too_large"),
    ],
    ids=["many bytes", "no JPEG", "many pixels", "no time", "short", "thumbnail of many bytes"],
)
@pytest.mark.parametrize("is_live", [True, False])
def test_garbage_ends_connection_of_its_phone_alone(service: Live, message: bytes, code: str, is_live: bool) -> None:
    recording = opened_recording(service)
    with recording.phone("Left") as left, recording.phone("Right") as right, opened(service) as connection:
        client = LiveSocket(connection)
        if is_live:
            client.send(start_message(*phone_sources(recording)))
            client.receive()
            live_of(left)
        left.socket.send(message)
        assert left.problem()["code"] == code
        if is_live:
            right.socket.send(packet(SHORT))
            assert told(client) == ["Right", 0, SHORT]


def test_pictures_too_fast_are_dropped_not_queued(service: Live) -> None:
    recording = opened_recording(service)
    with recording.phone("Left") as left, recording.phone("Right"), opened(service) as connection:
        client = LiveSocket(connection)
        client.send(start_message(*phone_sources(recording)))
        client.receive()
        live_of(left)
        for number in range(60):
            left.socket.send(packet(SHORT + bytes([number])))
        left.send("ping", t0_s=1.0)
        left.next("pong")
        # These have come before the capture is told to end.
        came = [told(client)[2][-1] for _ in range(5)]
        assert came == [0, 1, 2, 3, 4]
        client.send({"type": "end"})
        while (message := client.receive())["type"] == "notice":
            came.append(bytes.fromhex(json.loads(message["message"])[2])[-1])
        assert len(came) < 60
        assert message["counts"]["received"] == len(came)


def test_phones_that_are_not_there_are_told_all_at_once(service: Live) -> None:
    recording = opened_recording(service)
    with recording.host() as host:
        with recording.phone("Left"):
            host.state(lambda state: state["recording"]["phones"])
        cases = [
            (f"phone://{recording.id}/2", "The recording has no such phone.", "Its phones are 1 (Left)."),
            (f"phone://{recording.id}/01", "The recording has no such phone.", "Its phones are 1 (Left)."),
            (f"phone://{recording.id}", "The recording has no such phone.", "Its phones are 1 (Left)."),
            ("phone://01a22a35-8896-735e-bb06-b92d730202a0/1", "There is no such recording, or it has ended.", None),
            ("phone://../../etc/passwd", "There is no such recording, or it has ended.", None),
            ("phone://", "There is no such recording, or it has ended.", None),
        ]
        for source, message, hint in cases:
            with opened(service) as connection:
                client = LiveSocket(connection)
                client.send(start_message(source, "ftp://a/"))
                errors = client.problem()["errors"]
                assert [error["pointer"] for error in errors] == ["/cameras/0/source", "/cameras/1/source"]
                assert errors[0]["message"] == message
                assert hint in {None, errors[0]["hint"]}
        with opened(service) as connection:
            client = LiveSocket(connection)
            client.send(start_message(f"phone://{recording.id}/1", f"phone://{recording.id.upper()}/1"))
            (error,) = client.problem()["errors"]
            assert (error["pointer"], error["message"]) == (
                "/cameras/1/source",
                "The source is another camera's already.",
            )
        host.send("remove", phone=1)
        host.state(lambda state: state["recording"]["phones"][0]["is_removed"])
    with opened(service) as connection:
        client = LiveSocket(connection)
        client.send(start_message(f"phone://{recording.id}/1", "ftp://a/"))
        assert client.problem()["errors"][0]["message"] == "The recording has no such phone."


def test_recordings_of_other_tenants_are_unknown(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    with running(make_settings(**live_commands)) as live:
        rights = frozenset({Scope.READ, Scope.WRITE})
        secrets = [live.services.store.keys.add(tenant, "writer", rights)[1] for tenant in ("studio-a", "studio-b")]
        own, other = ({"Authorization": f"Bearer {secret}"} for secret in secrets)
        recording = opened_recording(live, own)
        for headers, message in (
            (own, "The recording has no such phone."),
            (other, "There is no such recording, or it has ended."),
        ):
            with opened(live, additional_headers=headers) as connection:
                client = LiveSocket(connection)
                client.send(start_message(f"phone://{recording.id}/1", "ftp://a/"))
                assert client.problem()["errors"][0]["message"] == message
