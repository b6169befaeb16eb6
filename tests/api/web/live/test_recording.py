"""Calibrations of live cameras: they are recorded for a moment, and their videos are calibrated as others are."""

import contextlib
import itertools
import struct
import threading
import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.recordings.conftest import PhoneSocket, opened_recording
from tests.pipeline.run.live.cameras.servers import mjpeg_camera, serving

pytestmark = pytest.mark.slow
BOARD = "chessboard:9x6:0.06"


def named(*addresses: str) -> list[dict[str, str]]:
    return [{"camera": f"cam_{place}", "source": address} for place, address in enumerate(addresses)]


def test_recorded_cameras_become_calibration(make_settings: Callable[..., Settings]) -> None:
    with (
        running(make_settings(preflight_command=Settings.model_fields["preflight_command"].default)) as service,
        serving(mjpeg_camera(10, 20.0)) as one,
        serving(mjpeg_camera(10, 10.0)) as other,
        opened(service) as connection,
    ):
        client = LiveSocket(connection)
        sources = named(f"http://127.0.0.1:{one.port}/", f"http://127.0.0.1:{other.port}/")
        start = {"type": "record_cameras", "cameras": sources, "duration_s": 2.0, "board": BOARD, "name": "Stage"}
        client.send(start)
        assert client.receive()["message"] == "The cameras are open, and are recorded for 2 s."
        recorded = client.receive(300.0)
        assert recorded["type"] == "recorded", recorded
        calibration = service.client.get(f"/v1/calibrations/{recorded['calibration_id']}").json()
        assert (calibration["name"], calibration["state"]) == ("Stage", "queued")
        session = service.client.get(calibration["urls"]["session"]).json()
        assert [file["name"] for file in session["files"]] == ["camera-0.mkv", "camera-1.mkv"]
        assert session["duration_s"] > 1.5


@contextlib.contextmanager
def filming(phone: PhoneSocket, late_s: float) -> Iterator[None]:
    """Phone that sends pictures in the block, whose times are late by its own account."""
    is_over = threading.Event()

    def send() -> None:
        for number in itertools.count():
            if is_over.wait(0.07):
                return
            _, jpeg = cv2.imencode(".jpg", np.full((180, 320, 3), number % 200, np.uint8))
            phone.socket.send(b"MCP1" + struct.pack("<d", time.time() - late_s) + bytes(jpeg))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def test_recorded_phones_become_calibration(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings(preflight_command=Settings.model_fields["preflight_command"].default)
    with running(settings) as service, opened(service) as connection:
        recording, client = opened_recording(service), LiveSocket(connection)
        with (
            recording.phone("Left") as left,
            recording.phone("Right") as right,
            filming(left, 0.0),
            filming(right, 0.5),
        ):
            sources = named(f"phone://{recording.id}/1", f"phone://{recording.id}/2")
            client.send({"type": "record_cameras", "cameras": sources, "duration_s": 3.0, "board": BOARD})
            assert left.next("live") == right.next("live") == {"type": "live", "is_on": True, "size_px": None}
            assert client.receive()["message"] == "The cameras are open, and are recorded for 3 s."
            recorded = client.receive(300.0)
        assert recorded["type"] == "recorded", recorded
        calibration = service.client.get(f"/v1/calibrations/{recorded['calibration_id']}").json()
        session = service.client.get(calibration["urls"]["session"]).json()
        first, second = session["preflight"]["cameras"]
        assert first["size_px"] == second["size_px"] == [320, 180]
        assert session["duration_s"] > 2.0


def test_wrong_recording_says_all_that_is_wrong(live_service: Live) -> None:
    for changes, pointers in [
        ({}, ["/cameras/0/source", "/board"]),
        ({"board": BOARD, "duration_s": 900.0}, ["/duration_s"]),
    ]:
        with opened(live_service) as connection:
            client = LiveSocket(connection)
            client.send({"type": "record_cameras", "cameras": named("ftp://x/", "http://127.0.0.1:1/")} | changes)
            problem = client.problem()
            assert problem["code"] == "live_fields"
            assert [error["pointer"] for error in problem["errors"]] == pointers
