"""Client of live captures: keypoints to a service, people and their skeletons back, while it happens.

``connect`` is asynchronous, ``connect_sync`` is for loops and threads::

    with multicap.live.connect_sync("http://127.0.0.1:8000", "calibration.json", "coco-17", 60.0) as capture:
        capture.send("cam_1", time_s, points_px, score)  # people x points x 2, people x points
        while (instant := capture.receive(timeout_s=0.0)) is not None:
            print(instant.time_s, [person.id for person in instant.people])

Instants come as ``LiveInstant``, whose people have located joints and, once their bones are learnt, a skeleton.
"""

import contextlib
import json
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit
from uuid import UUID

import numpy as np
from jaxtyping import Float
from websockets.asyncio.client import ClientConnection as AsyncConnection
from websockets.asyncio.client import connect as open_async
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import CloseCode
from websockets.sync.client import ClientConnection as SyncConnection
from websockets.sync.client import connect as open_sync

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.paths import StrPath
from pipeline.core.problems.requests import LIVE_STOPPED
from pipeline.run.live.packets import Dropped
from pipeline.run.live.packing import instant_of_json, pack_keypoints, unpack_instant
from pipeline.run.live.records import LiveInstant

__all__ = ["AsyncLive", "CaptureEnd", "LiveError", "LiveOptions", "SyncLive", "connect", "connect_sync"]

_START_S = 180.0
_CLOSE_S = 10.0
_VERSIONS: Mapping[str, str] = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}


class LiveError(Exception):
    """The service refused or ended a capture.

    Parameters
    ----------
    code
        Code of docs/problems.md.
    problem
        The whole problem, with ``errors`` and ``hint``.
    """

    def __init__(self, code: str, detail: str, problem: Mapping[str, Any]) -> None:
        super().__init__(f"{code}: {detail}")
        self.code, self.problem = code, problem


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Choices of a capture; docs/live_service.md describes them."""

    output_rate_hz: float | None = None
    window_s: float = 0.1
    is_ordered: bool = True
    learn_s: float = 3.0
    bodies: tuple[tuple[float, ...], ...] = ()
    joint_centers: str = "off"
    keep: bool = False
    name: str = "live"
    packed: bool = True  # Whether instants come as packets, which are shorter than JSON


@dataclass(frozen=True, slots=True)
class CaptureEnd:
    """End of a capture: numbers of frames, and the session of what was kept."""

    counts: Mapping[str, int]
    dropped: Dropped
    session_id: str | None
    kept_frames: int


class _Messages:
    """Messages of a capture, and the cameras that the service has named."""

    def __init__(self, ready: Mapping[str, Any]) -> None:
        self.cameras: tuple[str, ...] = tuple(ready["cameras"])
        self.joints: tuple[str, ...] = tuple(ready["joints"])
        self.bones: tuple[str, ...] = tuple(ready["bones"])
        self.dropped = Dropped()

    def keypoints(
        self,
        camera: str | int,
        time_s: float,
        points_px: Float[np.ndarray, "people points 2"],
        score: Float[np.ndarray, "people points"],
    ) -> bytes:
        """Packet of a camera's frame; ``ValueError`` if there is no such camera."""
        place = camera if isinstance(camera, int) else self.cameras.index(camera)
        return pack_keypoints(place, time_s, points_px, score)

    def read(self, message: str | bytes) -> LiveInstant | CaptureEnd:
        """Instant or end; raises ``LiveError`` for a problem."""
        if isinstance(message, bytes):
            instant, self.dropped = unpack_instant(message)
            return instant
        content = _content(message)
        if content["type"] == "ended":
            self.dropped = Dropped(**content["dropped"])
            return CaptureEnd(content["counts"], self.dropped, content["session_id"], content["kept_frames"])
        instant, self.dropped = instant_of_json(content)
        return instant


class AsyncLive(_Messages):
    """Live capture of an asynchronous program."""

    def __init__(self, connection: AsyncConnection, ready: Mapping[str, Any]) -> None:
        super().__init__(ready)
        self._connection = connection
        self.end: CaptureEnd | None = None

    async def send(
        self,
        camera: str | int,
        time_s: float,
        points_px: Float[np.ndarray, "people points 2"],
        score: Float[np.ndarray, "people points"],
    ) -> None:
        """Send a camera's frame: the points of the layout in pixels, NaN where not found, and their scores, 0 to 1."""
        with _closed_as_problem():
            try:
                await self._connection.send(self.keypoints(camera, time_s, points_px, score))
            except ConnectionClosed:
                # The problem may have come before the end of the connection.
                async for message in self._connection:
                    self.read(message)
                raise

    async def finish(self) -> None:
        """Say that the capture is over; its last instants still come, and ``end`` is set behind them."""
        with _closed_as_problem():
            await self._connection.send(json.dumps({"type": "end"}))

    async def __aiter__(self) -> AsyncIterator[LiveInstant]:
        """Instants until the end of the capture; raises ``LiveError``."""
        while self.end is None:
            with _closed_as_problem():
                message = self.read(await self._connection.recv())
            if isinstance(message, CaptureEnd):
                self.end = message
            else:
                yield message


class SyncLive(_Messages):
    """Live capture of a program without an event loop."""

    def __init__(self, connection: SyncConnection, ready: Mapping[str, Any]) -> None:
        super().__init__(ready)
        self._connection = connection

    def send(
        self,
        camera: str | int,
        time_s: float,
        points_px: Float[np.ndarray, "people points 2"],
        score: Float[np.ndarray, "people points"],
    ) -> None:
        """Send a camera's frame: the points of the layout in pixels, NaN where not found, and their scores, 0 to 1."""
        with _closed_as_problem():
            try:
                self._connection.send(self.keypoints(camera, time_s, points_px, score))
            except ConnectionClosed:
                # The problem may have come before the end of the connection.
                for message in self._connection:
                    self.read(message)
                raise

    def receive(self, timeout_s: float | None = None) -> LiveInstant | None:
        """Next instant; ``None`` if none comes in time (``timeout_s`` ``None``: waits). Raises ``LiveError``."""
        try:
            with _closed_as_problem():
                message = self.read(self._connection.recv(timeout_s))
        except TimeoutError:
            return None
        return message if isinstance(message, LiveInstant) else None

    def finish(self) -> tuple[list[LiveInstant], CaptureEnd]:
        """End the capture; return the instants that were still to come, and the end. Raises ``LiveError``."""
        instants = []
        with _closed_as_problem():
            self._connection.send(json.dumps({"type": "end"}))
            while not isinstance(message := self.read(self._connection.recv()), CaptureEnd):
                instants.append(message)
        return instants, message


@contextlib.asynccontextmanager
async def connect(
    url: str,
    calibration: StrPath | Mapping[str, Any],
    layout: str,
    frame_rate_hz: float,
    options: LiveOptions = LiveOptions(),
    *,
    key: str | None = None,
) -> AsyncIterator[AsyncLive]:
    """Begin a live capture at a service.

    Parameters
    ----------
    url
        Address of the service, such as ``http://127.0.0.1:8000``.
    calibration
        Calibration file in metres of any format, its content in JSON, or the id of a calibration of the service.
    layout
        Layout of the keypoints, such as ``coco-17``.
    frame_rate_hz
        Frame rate of the fastest camera.
    key
        Key of the service, if it asks for one.

    Raises
    ------
    InputError
        If the calibration file can't be read.
    LiveError
        If the service refuses the capture.
    OSError
        If the service can't be reached.
    """
    start = _start(calibration, layout, frame_rate_hz, options)
    with _refused_as_problem():
        connection = await open_async(
            _address(url),
            additional_headers=_headers(key),
            max_size=None,
            open_timeout=_START_S,
            close_timeout=_CLOSE_S,
        )
    async with connection:
        with _closed_as_problem():
            await connection.send(start)
            ready = _content(await connection.recv())
        yield AsyncLive(connection, ready)


@contextlib.contextmanager
def connect_sync(
    url: str,
    calibration: StrPath | Mapping[str, Any],
    layout: str,
    frame_rate_hz: float,
    options: LiveOptions = LiveOptions(),
    *,
    key: str | None = None,
) -> Iterator[SyncLive]:
    """Begin a live capture at a service; parameters and errors are the same as for ``connect``."""
    start = _start(calibration, layout, frame_rate_hz, options)
    with _refused_as_problem():
        connection = open_sync(
            _address(url),
            additional_headers=_headers(key),
            max_size=None,
            open_timeout=_START_S,
            close_timeout=_CLOSE_S,
        )
    with connection:
        with _closed_as_problem():
            connection.send(start)
            ready = _content(connection.recv())
        yield SyncLive(connection, ready)


def _address(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme not in _VERSIONS:
        raise ValueError("The address of a service begins with http:// or https://.")
    return urlunsplit((_VERSIONS[parts.scheme], parts.netloc, parts.path.rstrip("/") + "/v1/live", "", ""))


def _headers(key: str | None) -> dict[str, str]:
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def _start(calibration: StrPath | Mapping[str, Any], layout: str, frame_rate_hz: float, options: LiveOptions) -> str:
    return json.dumps(
        {
            "type": "start",
            **_cameras(calibration),
            "layout": layout,
            "frame_rate_hz": frame_rate_hz,
            "output_rate_hz": options.output_rate_hz,
            "window_s": options.window_s,
            "is_ordered": options.is_ordered,
            "learn_s": options.learn_s,
            "bodies": options.bodies,
            "joint_centers": options.joint_centers,
            "keep": options.keep,
            "name": options.name,
            "format": "packed" if options.packed else "json",
        }
    )


def _cameras(calibration: StrPath | Mapping[str, Any]) -> dict[str, Any]:
    if isinstance(calibration, Mapping):
        return {"calibration": calibration}
    with contextlib.suppress(ValueError):
        return {"calibration_id": str(UUID(str(calibration)))}
    path = Path(calibration)
    try:
        return {"calibration": read_json(path.read_bytes())}
    except (UnreadableError, OSError):
        # Of another form than JSON, or an error that says what is wrong.
        return {"calibration": json.loads(encode(read_calibration(path)))}


def _content(message: str | bytes) -> dict[str, Any]:
    """Content of a message in JSON; raises ``LiveError`` for a problem."""
    content: dict[str, Any] = json.loads(message)
    if content["type"] == "problem":
        raise LiveError(content["code"], content["detail"], content)
    return content


@contextlib.contextmanager
def _closed_as_problem() -> Iterator[None]:
    """Raise ``LiveError`` in place of the error of a closed connection."""
    try:
        yield
    except ConnectionClosed as closed:
        frame = closed.rcvd
        if frame is not None and frame.code == CloseCode.SERVICE_RESTART:
            raise LiveError(LIVE_STOPPED, "The service was stopped; begin again when it answers.", {}) from None
        code = frame.reason if frame is not None and frame.reason else "client_disconnected"
        raise LiveError(code, "The connection was closed.", {}) from None


@contextlib.contextmanager
def _refused_as_problem() -> Iterator[None]:
    """Raise ``LiveError`` in place of the answer of a service that opens no WebSocket."""
    try:
        yield
    except InvalidStatus as refused:
        try:
            problem = json.loads(refused.response.body or b"")
            code, detail = problem["code"], problem["detail"]
        except (ValueError, KeyError, TypeError):
            code, detail, problem = "service_unknown", f"The answer is {refused.response.status_code}.", {}
        raise LiveError(code, detail, problem) from None
