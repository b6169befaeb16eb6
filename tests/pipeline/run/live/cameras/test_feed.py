"""Feeds of cameras: real streams on loopback, cameras that go and come back, and what strangers send."""

import contextlib
import errno
import os
import queue
import socket
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import STREAM_REFUSED, STREAM_SILENT
from pipeline.core.problems.session_codes import NO_VIDEO_STREAM, VIDEO_UNREADABLE
from pipeline.run.live.cameras import feed as feeds
from pipeline.run.live.cameras.feed import (
    CameraFeed,
    FeedEnded,
    FeedEvent,
    FeedOpened,
    FrameDecoded,
    PictureReady,
)
from pipeline.run.live.cameras.sources import CameraSource
from tests.pipeline.media import picture, write_audio, write_video
from tests.pipeline.run.live.cameras.servers import (
    SIZE_PX,
    encoded_pictures,
    mjpeg_camera,
    rtsp_camera,
    serving,
    silent,
)
from tests.ports import free_port

WAIT_S = 30.0
Events = Iterator[FeedEvent]


@contextlib.contextmanager
def feeding(kind: str, address: str) -> Iterator[tuple[CameraFeed, Events]]:
    """Feed of a camera, and what happens, until the end of the block."""
    events: queue.SimpleQueue[FeedEvent | None] = queue.SimpleQueue()
    feed = CameraFeed(0, CameraSource("cam", kind, address), SIZE_PX, 2, events)  # type: ignore[arg-type]

    def happened() -> Events:
        end_s = time.monotonic() + WAIT_S
        while (event := events.get(timeout=max(0.01, end_s - time.monotonic()))) is not None:
            yield event

    try:
        yield feed, happened()
    finally:
        feed.close()
        feed.join()


def until(events: Events, kind: type, number: int = 1) -> list[FeedEvent]:
    """Events up to the given one of a kind."""
    seen = []
    for event in events:
        seen.append(event)
        number -= isinstance(event, kind)
        if number == 0:
            break
    return seen


def shown(event: FeedEvent) -> np.ndarray:
    """Picture that is ready."""
    assert isinstance(event, PictureReady)
    return np.array(np.memmap(event.pictures.path, np.uint8, "r", shape=event.pictures.shape)[event.slot])


def test_rtsp_has_camera_s_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that arrive up to 35 ms late are as far apart as the camera took them; a lost camera comes back."""
    monkeypatch.setattr(feeds, "_FIRST_PAUSE_S", 0.05)
    camera = rtsp_camera(encoded_pictures(10), 25.0, [0.0, 0.03, 0.0, 0.02, 0.035])
    with serving(camera) as server, feeding("rtsp", f"rtsp://127.0.0.1:{server.port}/stream") as (feed, events):
        seen = until(events, FrameDecoded, 30)
        assert isinstance(seen[0], FeedOpened)
        assert (seen[0].format.shown_size_px, round(seen[0].rate_hz)) == (SIZE_PX, 25)
        times_s = [event.time_s for event in seen if isinstance(event, FrameDecoded)][5:]
        steps_ms = 1000 * np.diff(times_s)
        np.testing.assert_allclose(steps_ms, 40.0 * np.round(steps_ms / 40.0), atol=5.0)
        feed.ask(1)
        image = shown(until(events, PictureReady)[-1])
        assert min(np.abs(image - picture(number, SIZE_PX).astype(float)).mean() for number in range(10)) < 3.0
        server.close()
        (*_, ended) = until(events, FeedEnded)
        assert isinstance(ended, FeedEnded)
        assert ended.problem is not None
        assert not ended.is_over
        with serving(camera, server.port):
            assert isinstance(until(events, FrameDecoded)[-2], FeedOpened)


def test_mjpeg_over_http_has_times_of_arrival() -> None:
    """FFmpeg would count 25 frames a second."""
    with serving(mjpeg_camera(10, 12.5)) as server, feeding("http", f"http://127.0.0.1:{server.port}/") as (_, events):
        seen = until(events, FrameDecoded, 14)
        times_s = [event.time_s for event in seen if isinstance(event, FrameDecoded)][3:]
        assert np.mean(np.diff(times_s)) == pytest.approx(0.08, abs=0.02)


@pytest.mark.slow
def test_mpeg_ts_over_http(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.ts", 50, SIZE_PX, options={"g": "5", "bf": "0"}).read_bytes()

    def camera(connection: socket.socket) -> None:
        connection.recv(65_536)
        connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n")
        for start in range(0, len(clip), len(clip) // 50):
            connection.sendall(clip[start : start + len(clip) // 50])
            time.sleep(0.04)

    with serving(camera) as server, feeding("http", f"http://127.0.0.1:{server.port}/") as (_, events):
        seen = until(events, FrameDecoded, 10)
        assert isinstance(seen[0], FeedOpened)
        assert seen[0].format.shown_size_px == SIZE_PX


def test_file_is_played_at_its_own_pace(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "clip.mp4", 12, SIZE_PX)
    with feeding("file", str(clip)) as (feed, events):
        until(events, FeedOpened)
        feed.ask(0)
        assert np.abs(shown(until(events, PictureReady)[-1]) - picture(0, SIZE_PX).astype(float)).mean() < 3.0
        start_s = time.monotonic() + 0.05
        feed.start(start_s)
        seen = until(events, FeedEnded)
        assert seen[-1] == FeedEnded(0, None, is_over=True)
        assert time.monotonic() - start_s >= 11 / 25
        times_s = [event.time_s - start_s for event in seen if isinstance(event, FrameDecoded)]
        np.testing.assert_allclose(times_s, np.arange(12) / 25, atol=1e-6)
        feed.ask(1)
        assert np.abs(shown(until(events, PictureReady)[-1]) - picture(11, SIZE_PX).astype(float)).mean() < 3.0


def test_file_s_rate_is_that_of_its_frames(tmp_path: Path) -> None:
    """The header says 60 Hz; the frames are 80 ms apart."""
    clip = write_video(tmp_path / "clip.mkv", 20, SIZE_PX, stamps=range(0, 1600, 80), rate_hz=60)
    with feeding("file", str(clip)) as (_, events):
        (opened,) = until(events, FeedOpened)
        assert isinstance(opened, FeedOpened)
        assert opened.rate_hz == pytest.approx(12.5)


def playlist(connection: socket.socket) -> None:
    connection.recv(65_536)
    body = b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile:///etc/hostname\n"
    connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: application/vnd.apple.mpegurl\r\n\r\n" + body)


def noise(connection: socket.socket) -> None:
    connection.recv(65_536)
    connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: video/mp2t\r\n\r\n")
    for _ in range(200):
        connection.sendall(os.urandom(65_536))


def unauthorised(connection: socket.socket) -> None:
    while request := connection.recv(65_536):
        number = request.partition(b"CSeq: ")[2].partition(b"\r\n")[0]
        answer = b"RTSP/1.0 401 Unauthorized\r\nCSeq: " + number + b'\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'
        connection.sendall(answer)


def endless(connection: socket.socket) -> None:
    while True:
        connection.sendall(b"RTSP/1.0 200 OK\r\n" + b"X: y\r\n" * 1000)


@pytest.mark.parametrize(
    ("kind", "answer", "codes"),
    [
        ("http", playlist, {VIDEO_UNREADABLE}),
        pytest.param("http", noise, {VIDEO_UNREADABLE, NO_VIDEO_STREAM, STREAM_SILENT}, marks=pytest.mark.slow),
        pytest.param("rtsp", unauthorised, {STREAM_REFUSED}, marks=pytest.mark.slow),
        ("rtsp", silent, {STREAM_SILENT}),
        pytest.param("rtsp", endless, {STREAM_SILENT, STREAM_REFUSED, VIDEO_UNREADABLE}, marks=pytest.mark.slow),
    ],
)
def test_no_camera_ends_with_problem(
    kind: str, answer: Callable[[socket.socket], None], codes: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeds, "_OPEN_S", 2.0)
    with serving(answer) as server, feeding(kind, f"{kind}://user:secret@127.0.0.1:{server.port}/x") as (_, events):
        event = next(events)
        assert isinstance(event, FeedEnded)
        assert isinstance(event.problem, Problem)
        assert event.problem.code in codes
        assert "secret" not in str(event.problem)
        assert event.problem.hint


def test_no_video_device_is_refused_by_driver() -> None:
    with feeding("device", "/dev/null") as (_, events):
        event = next(events)
        assert isinstance(event, FeedEnded)
        assert event.problem is not None
        assert (event.problem.code, "ioctl" in event.problem.message) == (STREAM_REFUSED, True)


def test_tries_are_further_and_further_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "_FIRST_PAUSE_S", 0.2)
    address = f"rtsp://127.0.0.1:{free_port()}/"
    with feeding("rtsp", address) as (_, events):
        ends_s = []
        for event in events:
            assert isinstance(event, FeedEnded)
            assert event.problem is not None
            assert event.problem.code == STREAM_REFUSED
            ends_s.append(time.monotonic())
            if len(ends_s) == 3:
                break
    first_s, second_s = (after - before for before, after in pairwise(ends_s))
    assert first_s >= 0.2
    assert second_s >= 0.4


def test_file_without_pictures(tmp_path: Path) -> None:
    sound = write_audio(tmp_path / "sound.mp4")
    with feeding("file", str(sound)) as (_, events):
        (event,) = until(events, FeedEnded)
        assert isinstance(event, FeedEnded)
        assert event.problem is not None
        assert (event.problem.code, event.is_over) == (NO_VIDEO_STREAM, True)


@pytest.mark.parametrize("kind", ["http", "rtsp"])
def test_camera_leads_to_no_other_address(kind: str) -> None:
    reached: list[bytes] = []

    def elsewhere(connection: socket.socket) -> None:
        reached.append(connection.recv(65_536))

    with serving(elsewhere) as other:

        def camera(connection: socket.socket) -> None:
            while request := connection.recv(65_536):
                head = "HTTP/1.1" if kind == "http" else "RTSP/1.0"
                status = "200 OK" if request.startswith(b"OPTIONS") else "302 Found"
                number = request.partition(b"CSeq: ")[2].partition(b"\r\n")[0].decode()
                lines = [f"{head} {status}", f"CSeq: {number}", f"Location: {kind}://127.0.0.1:{other.port}/x"]
                connection.sendall("\r\n".join([*lines, "Content-Length: 0", "", ""]).encode())

        with serving(camera) as server, feeding(kind, f"{kind}://127.0.0.1:{server.port}/x") as (_, events):
            event = next(events)
        assert isinstance(event, FeedEnded)
        assert event.problem is not None
        assert event.problem.code == {"http": STREAM_REFUSED, "rtsp": VIDEO_UNREADABLE}[kind]
        assert ("redirects" in (event.problem.hint or "")) == (kind == "http")
    assert reached == []


def test_machine_without_room_for_process_is_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(request: object) -> None:
        raise OSError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(feeds, "StreamProcess", refused)
    with feeding("rtsp", "rtsp://127.0.0.1:1/") as (_, events):
        event = next(events)
    assert isinstance(event, FeedEnded)
    assert event.problem is not None
    assert (event.problem.code, "Resource temporarily" in event.problem.message) == (VIDEO_UNREADABLE, True)
