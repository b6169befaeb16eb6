"""Feeds of phones: pictures with their own times, pictures that are none, and phones that go and come back."""

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import cv2
import numpy as np
import pytest

from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import STREAM_SILENT
from pipeline.core.problems.session_codes import VIDEO_CHANGES_SIZE
from pipeline.run.live.cameras import feed as feeds
from pipeline.run.live.cameras.feed import CameraFeed, FeedEnded, FeedEvent, FeedOpened, FrameDecoded, PictureReady
from pipeline.run.live.cameras.sources import CameraSource
from pipeline.run.live.packets import PhonePicture

WIDTH, HEIGHT, RATE_HZ, WAIT_S = 64, 48, 20.0, 60.0


def jpeg(number: int, size_px: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    """Picture of one gray, which tells its number."""
    _, encoded = cv2.imencode(".jpg", np.full((size_px[1], size_px[0], 3), 40 + 10 * number, np.uint8))
    return bytes(encoded)


@contextlib.contextmanager
def phone_feed() -> Iterator[tuple[CameraFeed, socket.socket, "queue.SimpleQueue[FeedEvent | None]"]]:
    """Feed of a phone, and the socket by which its pictures come."""
    events: queue.SimpleQueue[FeedEvent | None] = queue.SimpleQueue()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        source = CameraSource("cam", "phone", "phone://recording/1", pictures=theirs.fileno())
        feed = CameraFeed(0, source, (1920, 1080), 1, events)
        try:
            yield feed, ours, events
        finally:
            feed.close()
            feed.join()


def until(events: "queue.SimpleQueue[FeedEvent | None]", kind: type, number: int = 1) -> list[FeedEvent]:
    """Events up to the given one of a kind."""
    seen: list[FeedEvent] = []
    while sum(isinstance(event, kind) for event in seen) < number:
        event = events.get(timeout=WAIT_S)
        assert event is not None
        seen.append(event)
    return seen


@contextlib.contextmanager
def sending(pictures: socket.socket) -> Iterator[None]:
    """Phone that sends pictures in the block."""
    is_over = threading.Event()

    def send() -> None:
        while not is_over.wait(1 / RATE_HZ):
            with contextlib.suppress(BlockingIOError):
                pictures.send(PhonePicture(time.monotonic(), jpeg(1)).encode(), socket.MSG_DONTWAIT)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()


def test_pictures_have_times_of_phone_and_bad_ones_are_left_out() -> None:
    with phone_feed() as (feed, pictures, events):
        first_s = time.monotonic() - 1.0
        damaged = jpeg(2)[:20]
        sent = [(0.0, jpeg(0)), (0.1, jpeg(1)), (0.2, damaged), (0.05, jpeg(3)), (0.3, jpeg(4)), (1e6, jpeg(5))]
        for late_s, content in sent:  # a damaged one, one from before, and one from the future
            pictures.sendall(PhonePicture(first_s + late_s, content).encode())
        opened, *frames = until(events, FrameDecoded, 4)
        assert isinstance(opened, FeedOpened)
        assert opened.format.shown_size_px == (WIDTH, HEIGHT)
        times_s = [event.time_s for event in frames if isinstance(event, FrameDecoded)]
        np.testing.assert_allclose(np.array(times_s[:3]) - first_s, [0.0, 0.1, 0.3], atol=1e-6)
        assert first_s + 0.3 < times_s[3] <= time.monotonic()
        feed.ask(0)
        (ready,) = until(events, PictureReady)
        assert isinstance(ready, PictureReady)
        shown = np.memmap(ready.pictures.path, np.uint8, "r", shape=ready.pictures.shape)[ready.slot]
        assert abs(float(np.median(shown)) - 90) <= 2


def test_phone_that_leaves_is_open_again_when_it_returns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feeds, "_FIRST_PAUSE_S", 0.05)
    with phone_feed() as (_, pictures, events):
        with sending(pictures):
            until(events, FrameDecoded, 3)
        *_, ended = until(events, FeedEnded)
        assert isinstance(ended, FeedEnded)
        assert isinstance(ended.problem, Problem)
        assert (ended.problem.code, ended.problem.message) == (STREAM_SILENT, "The phone sends no pictures.")
        assert ended.problem.file == "phone://recording/1"
        assert not ended.is_over
        with sending(pictures):
            frames = until(events, FrameDecoded, 3)
        assert isinstance(frames[0], FeedOpened)
        times_s = [event.time_s for event in frames if isinstance(event, FrameDecoded)]
        assert all(after > before for before, after in pairwise(times_s))


def test_phone_that_is_turned_is_lost_with_reason() -> None:
    with phone_feed() as (_, pictures, events):
        for size_px in ((WIDTH, HEIGHT), (HEIGHT, WIDTH)):
            pictures.sendall(PhonePicture(time.monotonic(), jpeg(1, size_px)).encode())
        *_, ended = until(events, FeedEnded)
        assert isinstance(ended, FeedEnded)
        assert isinstance(ended.problem, Problem)
        assert ended.problem.code == VIDEO_CHANGES_SIZE


@pytest.mark.parametrize(
    "packet", [b"", b"MCP1", b"MCP1" + bytes(7), b"MCK1" + bytes(80), b"MCP1" + b"\xff" * 8 + b"x"]
)
def test_packets_that_are_no_pictures_are_told(packet: bytes) -> None:
    assert PhonePicture.decode(packet) is None
    whole = PhonePicture(12.5, b"\xff\xd8").encode()
    assert PhonePicture.decode(whole) == (12.5, b"\xff\xd8")
    assert whole == b"MCP1" + bytes.fromhex("0000000000002940") + b"\xff\xd8"
