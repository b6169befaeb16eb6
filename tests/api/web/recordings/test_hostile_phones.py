"""Hostile phones and hosts: wrong messages, floods, and more of everything than is allowed."""

import contextlib
import json
import socket as sockets
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import websockets

from api.web.settings import Settings
from tests.api.conftest import Live, problem_of, running
from tests.api.web.recordings.conftest import (
    JPEG,
    OpenedRecording,
    RoomSocket,
    file_fields,
    opened_recording,
    socket_of,
    taken,
)
from tests.waiting import wait_for


@contextlib.contextmanager
def joining(recording: OpenedRecording) -> Iterator[RoomSocket]:
    """Socket of a phone that has said nothing yet."""
    with socket_of(recording, subprotocols=[f"mc.link.{recording.secret}"]) as connection:
        yield RoomSocket(connection)


@pytest.mark.parametrize(
    ("message", "code", "close_code"),
    [
        ("{", "recording_message", 1007),
        ("[1]", "recording_message", 1008),
        ('"hello"', "recording_message", 1008),
        ('{"type": "start"}', "recording_message", 1008),
        ('{"type": ["hello"]}', "recording_message", 1008),
        ('{"type": "status", "state": "idle"}', "recording_message", 1008),
        ('{"type": "hello", "phone_id": "short"}', "recording_fields", 1008),
        ('{"type": "hello", "phone_id": "a-phone-id-of-a-test", "name": "\\u0000"}', "recording_fields", 1008),
        ('{"type": "hello", "phone_id": "a-phone-id-of-a-test", "is_admin": true}', "recording_fields", 1008),
        (b"\xff\xd8\xff", "recording_thumbnail", 1008),
        ("[" * 10_000, "recording_message", 1007),
        ("x" * 16_385, "recording_too_large", 1009),
        ("x" * 10_000_000, "recording_too_large", 1009),
        (bytes(10_000_000), "recording_too_large", 1009),
    ],
)
def test_wrong_first_message_ends_connection(
    recording: OpenedRecording, message: str | bytes, code: str, close_code: int
) -> None:
    with joining(recording) as phone:
        with contextlib.suppress(websockets.ConnectionClosed):
            phone.socket.send(message)
        problem = phone.problem()
    assert (problem["code"], problem["close_code"]) == (code, close_code)
    assert problem["request_id"]
    assert recording.read()["phones"] == []


# Names that no camera may have, or that show as others.
ODD_NAMES = ("../../etc/passwd", "a\\b", "..", " ", "a\u202eb", "a\u00a0b", "line\nline", "x" * 65)


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ({"type": "hello", "phone_id": "a-phone-id-of-a-test"}, "recording_message"),
        ({"type": "ping", "t0_s": "now"}, "recording_fields"),
        ({"type": "ping", "t0_s": 1e300}, "recording_fields"),
        ({"type": "status", "state": "idle", "battery": 7}, "recording_fields"),
        ({"type": "status", "state": "idle", "error": "x" * 200}, "recording_fields"),
        ({"type": "started", "take": -1, "first_frame_s": 1.0, "std_s": 0.1}, "recording_fields"),
        ({"type": "started", "take": 1, "first_frame_s": 1e20, "std_s": 0.1}, "recording_fields"),
        ({"type": "file", "take": 1, "upload_id": "../../etc/passwd"}, "recording_fields"),
        *(({"type": "rename", "name": name}, "recording_fields") for name in ODD_NAMES),
        *(({"type": kind, "take": 1}, "recording_message") for kind in ("upload", "start", "stop", "discard")),
        ({"type": "remove", "phone": 1}, "recording_message"),
        (bytes(30_001), "recording_too_large"),
        (b"GIF89a", "recording_thumbnail"),
        (b"\xff\xd8\xff", "recording_thumbnail"),
        (b"\xff\xd8" + b"\xff\xe0\x00\x00" * 5000, "recording_thumbnail"),
        (JPEG.replace(b"\x00\xb4", b"\xff\xff"), "recording_thumbnail"),
        (JPEG.replace(b"\x00\xf0", b"\x04\x01"), "recording_thumbnail"),
    ],
)
def test_wrong_later_message_ends_connection(recording: OpenedRecording, message: Any, code: str) -> None:
    with recording.host() as host, recording.phone("Left") as phone:
        phone.socket.send(message if isinstance(message, bytes) else json.dumps(message))
        assert phone.problem()["code"] == code
        host.state(lambda state: state["live"] and not state["live"][0]["is_connected"])


def test_numbers_that_json_does_not_have_are_refused(recording: OpenedRecording) -> None:
    with recording.phone("Left") as phone:
        phone.socket.send('{"type": "ping", "t0_s": NaN}')
        assert phone.problem()["code"] in {"recording_message", "recording_fields"}


def test_hosts_send_no_pictures_and_no_wrong_messages(recording: OpenedRecording) -> None:
    for message, code in ((JPEG, "recording_thumbnail"), ('{"type": "file"}', "recording_message")):
        with recording.host() as host:
            host.socket.send(message)
            assert host.problem()["code"] == code


@pytest.fixture(scope="module")
def strict(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Running service that is strict about rates."""
    with running(make_settings(max_recording_messages_per_s=50.0, max_recording_phones=2)) as live:
        yield live


@pytest.fixture
def impatient(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    """Running service that is strict about silence."""
    with running(make_settings(recording_idle_s=1.0)) as live:
        yield live


def test_floods_end_connection_of_flooder_alone(strict: Live) -> None:
    recording = opened_recording(strict)
    ping = json.dumps({"type": "ping", "t0_s": 0.0})
    with recording.host() as host, recording.phone("Left") as flooder, recording.phone("Right") as other:
        with contextlib.suppress(websockets.ConnectionClosed):
            for _ in range(5000):
                flooder.socket.send(ping)
        assert flooder.problem()["code"] == "recording_too_fast"
        other.send("ping", t0_s=1.0)
        assert other.next("pong")["t0_s"] == 1.0
        host.state(lambda state: [phone["is_connected"] for phone in state["live"]] == [False, True])


def test_control_frames_do_no_harm(strict: Live) -> None:
    recording = opened_recording(strict)
    with recording.phone("Left") as phone:
        answers = [phone.socket.ping() for _ in range(3000)]
        assert answers[-1].wait(30.0)
        phone.send("ping", t0_s=1.0)
        assert phone.next("pong")


def test_thumbnails_too_fast_are_dropped_not_queued(strict: Live) -> None:
    recording = opened_recording(strict)
    with recording.host() as host, recording.phone("Left") as phone:
        for number in range(40):
            phone.socket.send(JPEG + bytes([number]))
        phone.send("ping", t0_s=1.0)
        phone.next("pong")
        shown = []
        with contextlib.suppress(TimeoutError):
            while True:
                shown.append(host.thumbnail(1.0)[-1])
    assert 1 <= len(shown) <= 3
    text = strict.client.get("/metrics").text
    assert 'multicap_recording_thumbnails_total{outcome="dropped"}' in text


def test_host_that_reads_nothing_delays_no_phone(strict: Live) -> None:
    recording = opened_recording(strict)
    with recording.host() as slow, recording.host() as host, recording.phone("Left") as phone:
        slow.state(lambda state: True)
        slow.socket.socket.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
        for number in range(6):
            phone.socket.send(JPEG + bytes(29_000) + bytes([number]))
            phone.send("ping", t0_s=float(number))
            phone.next("pong")
            assert host.thumbnail()[-1] == number
            time.sleep(0.55)


def test_silent_phones_are_disconnected(impatient: Live) -> None:
    recording = opened_recording(impatient)
    with joining(recording) as phone:
        assert phone.problem()["code"] == "recording_idle"
    with recording.phone("Left") as phone, recording.host() as host:
        assert phone.problem()["code"] == "recording_idle"
        host.send("ping", t0_s=0.0)  # hosts may be silent
        assert host.next("pong")


def test_only_so_many_connections_may_be_silent(strict: Live) -> None:
    recording = opened_recording(strict)
    silent = strict.services.rooms.num_greeting
    with joining(recording), recording.phone("Left") as phone:
        with joining(recording):
            wait_for(lambda: silent[recording.id] == 2)
            with joining(recording) as third:
                problem = third.problem()
                assert (problem["code"], problem["close_code"], problem["retryable"]) == ("recording_busy", 1013, True)
        wait_for(lambda: silent[recording.id] == 1)
        phone.send("ping", t0_s=1.0)
        assert phone.next("pong")["t0_s"] == 1.0
        with recording.phone("Right"):
            pass
    wait_for(lambda: recording.id not in silent)


def test_there_are_only_so_many_phones_and_hosts(recording: OpenedRecording) -> None:
    with recording.phone(), recording.phone(), recording.phone(), joining(recording) as fourth:
        fourth.send("hello", phone_id="the-fourth-of-three-phones")
        problem = fourth.problem()
        assert (problem["code"], problem["detail"]) == (
            "conflict",
            "A recording has 3 phones at most; the host may remove one.",
        )
    with recording.host() as host, recording.host() as other:
        host.state(lambda state: True)
        other.state(lambda state: True)
        with recording.host() as third:
            problem = third.problem()
            assert (problem["code"], problem["close_code"], problem["retryable"]) == ("recording_busy", 1013, True)


def test_phones_that_join_again_and_again_are_stopped(recording: OpenedRecording) -> None:
    with recording.host() as host:
        for number in range(1, 16):  # three at a time, and four times as many that were removed
            with recording.phone() as phone:
                host.send("remove", phone=number)
                assert phone.ended() == "removed"
        with joining(recording) as phone:
            phone.send("hello", phone_id="the-sixteenth-of-all-phones")
            assert phone.problem()["code"] == "conflict"


def test_phones_send_only_so_many_uploads_and_bytes(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone() as left, recording.phone() as right:
        problem_of(left.begin_upload(50_001), 409, "conflict")
        upload_id = left.upload(b"x" * 40_000)
        assert "50,000 bytes" in problem_of(right.begin_upload(10_001), 409, "conflict")["detail"]
        for _ in range(4):
            assert right.begin_upload(1).status_code == 201
        problem_of(left.begin_upload(1), 409, "conflict")
        # A take that is discarded makes room.
        take = taken(host)
        left.send("file", **file_fields(1, upload_id, take["start_s"], 40_000))
        host.state(lambda state: state["recording"]["takes"][0]["clips"])
        host.send("discard", take=1)
        left.next("delete")
        assert left.begin_upload(40_000).status_code == 201


def test_phone_reports_only_so_many_parts(recording: OpenedRecording) -> None:
    with recording.host() as host, recording.phone() as phone:
        take = taken(host)
        upload_id = phone.upload(b"video")
        for part in range(1, 102):
            phone.send("file", **file_fields(1, upload_id, take["start_s"]), part=part)
            time.sleep(0.06)
        assert phone.next("problem")["detail"] == "A clip has 100 parts at most."
    assert len(recording.read()["takes"][0]["clips"][0]["files"]) == 100
