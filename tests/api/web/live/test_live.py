"""Live captures: the way of a capture, and what each wrong message gets."""

import doctest
import json
import math
import struct
from typing import Any

import pytest

import multicap.live
import multicap.live_messages
from tests.api.conftest import Live
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import CALIBRATION, CAMERAS, keypoints_message, packet, start_message

NAN = float("nan")


def test_capture_from_start_to_end(live_socket: LiveSocket) -> None:
    ready = live_socket.start()
    assert ready["type"] == "ready"
    assert ready["cameras"] == list(CAMERAS)
    assert ready["layout"] == "coco-17"
    assert ready["limits"] == {"message_bytes": 100_000, "messages_per_s": 4000.0, "people": 8, "idle_s": 20.0}
    live_socket.send(keypoints_message("left", 0.0))
    live_socket.send(keypoints_message(1, 0.04, people=0))
    live_socket.send(packet(1, time_s=0.08))
    instants, end = live_socket.ended()
    assert [instant["time_s"] for instant in instants] == [0.0, 0.04, 0.08]
    assert [instant["sequence"] for instant in instants] == [0, 1, 2]
    assert instants[0]["dropped"] == {"input": 0, "output": 0}
    assert end["counts"] == {"received": 3, "taken": 3, "late": 0, "too_late": 0}
    assert end["session_id"] is None
    assert end["kept_frames"] == 0


def test_packed_instants_have_heads(live_socket: LiveSocket) -> None:
    live_socket.start(format="packed")
    live_socket.send(packet(time_s=1.5))
    instant = live_socket.receive()
    assert struct.unpack("<4sHHHHdfIII", instant) == (b"MCI1", 0, 1, 1, 0, 1.5, 0.5, 0, 0, 0)


WRONG_STARTS: dict[str, tuple[Any, str, int, str | None]] = {
    "not_json": ("{", "live_message", 1007, None),
    "not_an_object": ("[1]", "live_message", 1008, None),
    "deep": ("[" * 50_000, "live_message", 1007, None),
    "packed": (b"MCK1", "live_message", 1008, None),
    "keypoints_first": (keypoints_message(), "live_message", 1008, None),
    "no_layout": ({"type": "start", "calibration": {}, "frame_rate_hz": 25.0}, "live_fields", 1008, "/layout"),
    "layout": (start_message(layout="coco"), "live_fields", 1008, "/layout"),
    "rate": (start_message(frame_rate_hz=NAN), "live_fields", 1008, "/frame_rate_hz"),
    "rate_as_text": (start_message(frame_rate_hz="25"), "live_fields", 1008, "/frame_rate_hz"),
    "unknown": (start_message(rate=25), "live_fields", 1008, "/rate"),
    "no_calibration": (start_message(calibration=None), "live_fields", 1008, "/calibration"),
    "two_calibrations": (
        start_message(calibration_id="019f8b1e-0000-7000-8000-000000000000"),
        "live_fields",
        1008,
        "/calibration_id",
    ),
    "strange_calibration": (
        start_message(calibration=None, calibration_id="019f8b1e-0000-7000-8000-000000000000"),
        "live_fields",
        1008,
        "/calibration_id",
    ),
    "empty_calibration": (start_message(calibration={"cameras": []}), "live_fields", 1008, "/calibration"),
    "many_cameras": (
        start_message(calibration={"cameras": [{"name": f"cam_{place}"} for place in range(5)]}),
        "live_fields",
        1008,
        None,
    ),
    "refused_by_computation": (start_message(learn_s=59.0), "live_fields", 1008, None),
}


@pytest.mark.parametrize("case", WRONG_STARTS)
def test_wrong_starts(live_socket: LiveSocket, case: str) -> None:
    message, code, close_code, pointer = WRONG_STARTS[case]
    live_socket.send(message)
    problem = live_socket.problem()
    assert (problem["code"], problem["close_code"]) == (code, close_code)
    assert pointer is None or pointer in [error["pointer"] for error in problem["errors"]]


WRONG_FRAMES: dict[str, tuple[Any, str, int]] = {
    "not_json": ("nonsense", "live_message", 1007),
    "another_type": ({"type": "stop"}, "live_message", 1008),
    "no_type": ({}, "live_message", 1008),
    "second_start": (start_message(), "live_message", 1008),
    "end_with_more": ({"type": "end", "now": True}, "live_fields", 1008),
    "camera": (keypoints_message("middle"), "live_camera", 1008),
    "place": (keypoints_message(2), "live_camera", 1008),
    "points": (keypoints_message(people=0) | {"people": [[[1, 2, 0.5]] * 16]}, "live_joints", 1008),
    "nan": (json.dumps(keypoints_message() | {"people": [[[NAN, 2, 0.5]] * 17]}), "live_fields", 1008),
    "infinite_time": (json.dumps(keypoints_message(time_s=math.inf)), "live_fields", 1008),
    "score": (keypoints_message() | {"people": [[[1, 2, 1.5]] * 17]}, "live_fields", 1008),
    "pixels": (keypoints_message() | {"people": [[[1, 2e6, 0.5]] * 17]}, "live_fields", 1008),
    "shape": (keypoints_message() | {"people": [[1, 2, 0.5]]}, "live_fields", 1008),
    "pairs": (keypoints_message() | {"people": [[[1, 2]] * 17]}, "live_fields", 1008),
    "texts": (keypoints_message() | {"people": [[["1", "2", "0.5"]] * 17]}, "live_fields", 1008),
    "crowd": (keypoints_message(people=9), "live_too_large", 1008),
    "many_unknown_fields": ({"type": "keypoints"} | {f"f{place}": 1 for place in range(8000)}, "live_fields", 1008),
    "large_text": ("x" * 100_001, "live_too_large", 1009),
    "large_packet": (bytes(10_000_000), "live_too_large", 1009),
    "no_packet": (b"MCK2" + packet()[4:], "live_packet", 1008),
    "empty_packet": (b"", "live_packet", 1008),
    "short_packet": (packet()[:-1], "live_packet", 1008),
    "packed_camera": (packet(camera=2), "live_camera", 1008),
    "packed_points": (packet(points=16), "live_joints", 1008),
    "packed_nan": (packet(number=NAN), "live_packet", 1008),
    "packed_infinite": (packet(number=math.inf), "live_packet", 1008),
    "packed_score": (packet(number=2.0), "live_packet", 1008),
    "packed_crowd": (packet(people=9), "live_too_large", 1008),
    "packed_time": (packet(time_s=NAN), "live_packet", 1008),
    "crash": (packet(time_s=666.0), "live_failed", 1011),
    "hang": (packet(time_s=999.0), "live_failed", 1011),
}


@pytest.mark.parametrize("case", WRONG_FRAMES)
def test_wrong_frames(live_socket: LiveSocket, case: str) -> None:
    message, code, close_code = WRONG_FRAMES[case]
    assert live_socket.start()["type"] == "ready"
    live_socket.send(message)
    problem = live_socket.problem()
    assert (problem["code"], problem["close_code"]) == (code, close_code)
    assert problem["request_id"]


def test_times_do_not_jump_ahead(live_socket: LiveSocket) -> None:
    live_socket.start()
    live_socket.send(packet(time_s=-3.0))
    live_socket.send(packet(time_s=57.5))
    assert live_socket.problem()["code"] == "live_time"


def test_text_that_is_not_utf8(live_socket: LiveSocket) -> None:
    live_socket.start()
    live_socket.socket.send(b"\xff\xfe", text=True)
    problem = live_socket.problem()
    assert (problem["code"], problem["close_code"]) == ("live_message", 1007)


def test_oldest_frames_are_dropped_and_counted(live_socket: LiveSocket) -> None:
    live_socket.start(frame_rate_hz=250.0)  # slower cameras would wait
    for number in range(1100):
        live_socket.send(packet(time_s=100.0 + number * 1e-4))
    live_socket.send(packet(time_s=101.0))
    # The process takes 50 ms for each of these frames, and then none: the rest is dropped to make room.
    for number in range(1030):
        live_socket.send(packet(time_s=50.0 + number * 1e-4))
    instants, end = live_socket.ended()
    dropped = end["dropped"]["input"]
    assert dropped > 1000
    assert end["counts"]["received"] == 2131
    assert end["counts"]["taken"] == 2131 - dropped
    assert instants[-1]["dropped"]["input"] == dropped
    assert instants[-1]["time_s"] == pytest.approx(50.1029)


def test_oldest_instants_are_dropped_and_counted(live_service: Live) -> None:
    with opened(live_service) as connection:
        socket = LiveSocket(connection)
        socket.start()
        # 40 MB of instants, which the client takes only afterwards: buffers between them hold a part.
        for number in range(200):
            socket.send(packet(time_s=200.0 + number * 1e-3))
        socket.send({"type": "end"})
        messages = []
        while (message := socket.receive())["type"] == "instant":
            messages.append(message)
        assert message["counts"]["taken"] == 200
        assert len(messages) + message["dropped"]["output"] == 200
        sequences = [message["sequence"] for message in messages]
        assert sequences == sorted(set(sequences))
        assert sequences[-1] == 199


def test_examples_of_client_run(live_service: Live) -> None:
    names = {"address": f"http://127.0.0.1:{live_service.address[1]}", "calibration": CALIBRATION}
    client = doctest.testmod(multicap.live, extraglobs=names)
    messages = doctest.testmod(multicap.live_messages)
    assert client.attempted + messages.attempted > 15
    assert client.failed == messages.failed == 0
