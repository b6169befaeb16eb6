"""Browsers as phones: each with a video file as its camera, whose frames are numbered in the picture."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from jaxtyping import UInt8
from playwright.sync_api import BrowserContext, Page, ViewportSize, expect

from tests.e2e.browsing import FLAGS, chromium_path

# Frames of the clip, forth and back: a camera that plays it over and over shows motion without jumps.
NUM_BITS = 8
BLOCK_PX = 16
PORTRAIT: ViewportSize = {"width": 390, "height": 844}
LANDSCAPE: ViewportSize = {"width": 844, "height": 390}
CAMERA = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")


# Notes the place of each frame that the phone shows, with the time at which its camera took it, in seconds since 1970.
WATCH = """([numBits, blockPx]) => {
  const video = document.querySelector("video");
  const drawing = new OffscreenCanvas(numBits * blockPx, blockPx).getContext("2d", { willReadFrequently: true });
  globalThis.seen = [];
  const look = (now, { captureTime }) => {
    video.requestVideoFrameCallback(look);
    drawing.drawImage(video, 0, 0);
    const { data, width } = drawing.getImageData(0, 0, numBits * blockPx, blockPx);
    const bright = (bit) => data[4 * (width * (blockPx / 2) + blockPx * bit + blockPx / 2)] > 128;
    const place = Array.from({ length: numBits }, (_, bit) => bright(bit) << bit).reduce((sum, bit) => sum + bit, 0);
    seen.push([(performance.timeOrigin + captureTime) / 1000, place]);
  };
  video.requestVideoFrameCallback(look);
}"""


@dataclass(frozen=True, slots=True)
class Phone:
    """Browser that plays a phone."""

    name: str
    context: BrowserContext
    page: Page

    def allow_camera(self) -> None:
        self.page.get_by_role("button", name="Allow the camera").click()

    def watch(self) -> None:
        """Note from now on which frame is taken when."""
        self.page.evaluate(WATCH, [NUM_BITS, BLOCK_PX])

    def taken(self) -> list[tuple[float, int]]:
        """Times and places of frames since ``watch``."""
        return [(time_s, place) for time_s, place in self.page.evaluate("seen")]

    def expect_state(self, words: str) -> None:
        expect(self.page.locator(".phone-head .state")).to_have_text(words)


def there_and_back(count: int) -> list[int]:
    """Numbers of frames of a clip that is played forth and back without an end."""
    return [*range(count), *range(count - 2, 0, -1)]


def write_camera(
    video: Path,
    target: Path,
    rate_hz: int,
    *,
    every: int = 1,
    hold: int = 1,
    shift: int = 0,
    down_px: int = 0,
    size_px: tuple[int, int] | None = None,
) -> int:
    """Write a video as a file that Chromium takes for a camera, there and back; return the number of its places.

    Each frame has its place in the file as a bar of blocks. The file is played at a whole rate, which Chromium knows
    alone.

    Parameters
    ----------
    every
        Every how many places there is a frame.
    hold
        Frames of each place. A file that is written again at the same place shows another moment at once.
    shift
        Frames by which the file begins later.
    down_px
        Even number of pixels by which the picture is lower, as of a camera that was tilted up; it wraps around.
    size_px
        Width and height of the pictures; by default those of the video.
    """
    with av.open(video) as source:
        stream = source.streams.video[0]
        width, height = size_px or (stream.width, stream.height)
        frames = [frame.reformat(width, height, "yuv420p").to_ndarray() for frame in source.decode(stream)]
    places = there_and_back(len(frames))
    shown = [place for place in range(0, len(places), every) for _ in range(hold)]
    with target.open("r+b" if target.exists() else "wb") as file:
        file.write(f"YUV4MPEG2 W{width} H{height} F{rate_hz // every}:1 Ip A1:1 C420jpeg\n".encode())
        for place in np.roll(shown, shift).tolist():
            picture = _lowered(frames[places[place]], height, down_px)
            for bit in range(NUM_BITS):
                left = bit * BLOCK_PX
                picture[:BLOCK_PX, left : left + BLOCK_PX] = 235 if place >> bit & 1 else 16
            file.write(b"FRAME\n" + picture.tobytes())
    return len(places)


def _lowered(
    picture: UInt8[np.ndarray, "rows columns"], height: int, down_px: int
) -> UInt8[np.ndarray, "rows columns"]:
    """Copy of a picture in YUV 4:2:0 that is lower: a plane of brightness, and two of colour of half the size."""
    light, colors = picture[:height], picture[height:].reshape(2, height // 2, -1)
    lowered = np.roll(colors, down_px // 2, axis=1).reshape(picture[height:].shape)
    return np.concatenate([np.roll(light, down_px, axis=0), lowered])


def read_places(video: Path) -> list[tuple[float, int]]:
    """Time and place in the camera's file of each frame of a recording."""
    with av.open(video) as source:
        stream = source.streams.video[0]
        found = []
        for frame in source.decode(stream):
            gray = frame.to_ndarray(format="gray")
            blocks = gray[:BLOCK_PX, : NUM_BITS * BLOCK_PX].reshape(BLOCK_PX, NUM_BITS, BLOCK_PX)[4:-4, :, 4:-4]
            bits = blocks.mean((0, 2)) > 128
            assert frame.time is not None
            found.append((frame.time, int(np.dot(bits, 1 << np.arange(NUM_BITS)))))
    return found


@contextlib.contextmanager
def phones(
    host: Page, link: str, cameras: Sequence[tuple[str, Path]], folder: Path, viewport: ViewportSize = PORTRAIT
) -> Iterator[list[Phone]]:
    """Open a link in a browser for each camera, which have a name and a file; they have not joined yet."""
    browser = host.context.browser
    assert browser is not None
    with contextlib.ExitStack() as held:
        opened = []
        for name, file in cameras:
            context = browser.browser_type.launch_persistent_context(
                folder / name,
                executable_path=chromium_path(),
                args=[*FLAGS, *CAMERA, f"--use-file-for-fake-video-capture={file}"],
                viewport=viewport,
                permissions=["camera", "microphone"],
            )
            held.callback(context.close)
            page = context.pages[0]
            page.goto(link)
            page.get_by_label("Name of this phone").fill(name)
            opened.append(Phone(name, context, page))
        yield opened


class RoomNetwork:
    """Network between phones and the service: a proxy on loopback that is slow, and can be cut for a while."""

    _BLOCK_BYTES = 2**14

    def __init__(self, port: int, bytes_per_s: float) -> None:
        self._port, self._bytes_per_s = port, bytes_per_s
        self._is_cut = threading.Event()
        self._listening = socket.create_server(("127.0.0.1", 0), backlog=128)
        self._open: set[socket.socket] = set()

    @property
    def port(self) -> int:
        return int(self._listening.getsockname()[1])

    def cut(self) -> None:
        """End all connections, and refuse new ones."""
        self._is_cut.set()
        for end in list(self._open):
            self._end(end)

    def mend(self) -> None:
        self._is_cut.clear()

    def close(self) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.cut()

    def serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                phone, _ = self._listening.accept()
                threading.Thread(target=self._pass_on, args=[phone], daemon=True).start()

    def _pass_on(self, phone: socket.socket) -> None:
        if self._is_cut.is_set():
            phone.close()
            return
        service = socket.create_connection(("127.0.0.1", self._port), timeout=180)
        both = {phone, service}
        self._open |= both
        back = threading.Thread(target=self._copy, args=[service, phone, 0.0], daemon=True)
        back.start()
        self._copy(phone, service, 1.0 / self._bytes_per_s)
        back.join()
        for end in both:
            self._end(end)
        self._open -= both

    def _copy(self, source: socket.socket, target: socket.socket, byte_s: float) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(self._BLOCK_BYTES):
                target.sendall(data)
                time.sleep(byte_s * len(data))
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)

    def _end(self, end: socket.socket) -> None:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()


@contextlib.contextmanager
def room_network(port: int, bytes_per_s: float) -> Iterator[RoomNetwork]:
    """Network of phones during the block; ``bytes_per_s`` is what each of their connections carries up."""
    network = RoomNetwork(port, bytes_per_s)
    thread = threading.Thread(target=network.serve, daemon=True)
    thread.start()
    try:
        yield network
    finally:
        network.close()
        thread.join(10)
