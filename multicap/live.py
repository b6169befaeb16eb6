"""Client of live captures: keypoints to a service, people and their skeletons back, while it happens.

``connect`` is asynchronous, ``connect_sync`` is for loops and threads. Instants come as ``LiveInstant``, whose people
have located joints and, once their bones are learnt, a skeleton. ``docs/live_service.md`` describes the protocol.

The examples of this module run against a service at ``address`` with a ``calibration`` of two cameras.
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
    detail
        Sentence for the user.
    problem
        The whole problem, with ``errors`` and ``hint``; empty if the service did not send one.

    Examples
    --------
    >>> error = LiveError("live_too_fast", "Too many messages came.", {"hint": "Send fewer."})
    >>> str(error), error.code, error.problem["hint"]
    ('live_too_fast: Too many messages came.', 'live_too_fast', 'Send fewer.')
    """

    def __init__(self, code: str, detail: str, problem: Mapping[str, Any]) -> None:
        super().__init__(f"{code}: {detail}")
        self.code, self.problem = code, problem


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Choices of a capture; docs/live_service.md describes them.

    Parameters
    ----------
    output_rate_hz
        Rate of the instants; ``None``: the frame rate of the cameras.
    window_s
        Longest time that a frame waits for earlier frames of other cameras.
    is_ordered
        Whether each camera sends its frames in the order of their times; if not, every frame waits for ``window_s``.
    learn_s
        Time in sight after which the bones of a person are learnt.
    bodies
        Lengths of the bones of people of earlier takes, in metres, as ``multicap.read_bodies`` reads them.
    joint_centers
        Detector whose marks are moved to the centres of the joints, such as ``movenet-multipose``; ``off``: none.
    keep
        Whether the service keeps the keypoints as a session.
    name
        Name of that session.
    packed
        Whether instants come as packets, which are shorter than JSON.

    Examples
    --------
    >>> options = LiveOptions(window_s=0.2, keep=True, name="Take 3")
    >>> options.output_rate_hz is None, options.learn_s
    (True, 3.0)
    """

    output_rate_hz: float | None = None
    window_s: float = 0.1
    is_ordered: bool = True
    learn_s: float = 3.0
    bodies: tuple[tuple[float, ...], ...] = ()
    joint_centers: str = "off"
    keep: bool = False
    name: str = "live"
    packed: bool = True


@dataclass(frozen=True, slots=True)
class CaptureEnd:
    """End of a capture: numbers of frames, and the session of what was kept.

    Parameters
    ----------
    counts
        Numbers of frames by what became of them: ``received``, ``taken``, ``late``, ``too_late``.
    dropped
        Frames and instants that were dropped because a side was too slow.
    session_id
        Session of the kept keypoints; ``None`` without ``LiveOptions.keep``.
    kept_frames
        Number of frames in that session.

    Examples
    --------
    >>> end = CaptureEnd({"received": 2, "taken": 2, "late": 0, "too_late": 0}, Dropped(), None, 0)
    >>> end.counts["taken"], end.dropped.output, end.session_id
    (2, 0, None)
    """

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
    """Live capture of an asynchronous program, made by ``connect``.

    It is an iterator of instants. Frames are sent by another task, such as one of a group.

    Attributes
    ----------
    cameras, joints, bones
        Names of the cameras, of the located joints, and of the skeleton's bones, in the order of the arrays.
    end
        End of the capture; ``None`` until the last instant has come.

    Examples
    --------
    >>> import asyncio
    >>> import numpy as np
    >>> async def capture_frames():
    ...     async with connect(address, calibration, "coco-17", 25.0) as capture:
    ...         await capture.send("left", 0.0, np.zeros((0, 17, 2)), np.zeros((0, 17)))
    ...         await capture.finish()
    ...         return [instant.time_s async for instant in capture], capture.end.counts["taken"]
    >>> asyncio.run(capture_frames())
    ([0.0], 1)
    """

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
        """Send a camera's frame.

        Parameters
        ----------
        camera
            Name of the camera, or its number in ``cameras``.
        time_s
            Time of the frame on the cameras' clock.
        points_px
            Points of the layout in pixels of the distorted image, NaN where a point was not found.
        score
            Confidence of the detector in each point, 0 to 1.

        Raises
        ------
        LiveError
            If the service has ended the capture.
        ValueError
            If there is no such camera.
        """
        with _closed_as_problem():
            try:
                await self._connection.send(self.keypoints(camera, time_s, points_px, score))
            except ConnectionClosed:
                # The problem may have come before the end of the connection.
                async for message in self._connection:
                    self.read(message)
                raise

    async def finish(self) -> None:
        """End the capture; its last instants still come, and ``end`` is set after them. Raises ``LiveError``."""
        with _closed_as_problem():
            await self._connection.send(json.dumps({"type": "end"}))

    async def __aiter__(self) -> AsyncIterator[LiveInstant]:
        """Yield instants until the end of the capture; raises ``LiveError`` if the service ends it by a problem."""
        while self.end is None:
            with _closed_as_problem():
                message = self.read(await self._connection.recv())
            if isinstance(message, CaptureEnd):
                self.end = message
            else:
                yield message


class SyncLive(_Messages):
    """Live capture of a program without an event loop, made by ``connect_sync``.

    Attributes
    ----------
    cameras, joints, bones
        Names of the cameras, of the located joints, and of the skeleton's bones, in the order of the arrays.

    Examples
    --------
    >>> import numpy as np
    >>> with connect_sync(address, calibration, "coco-17", 25.0) as capture:
    ...     capture.send("left", 0.0, np.zeros((0, 17, 2)), np.zeros((0, 17)))
    ...     instants, end = capture.finish()
    >>> [(instant.time_s, len(instant.people)) for instant in instants], end.counts["taken"]
    ([(0.0, 0)], 1)
    """

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
        """Send a camera's frame.

        Parameters
        ----------
        camera
            Name of the camera, or its number in ``cameras``.
        time_s
            Time of the frame on the cameras' clock.
        points_px
            Points of the layout in pixels of the distorted image, NaN where a point was not found.
        score
            Confidence of the detector in each point, 0 to 1.

        Raises
        ------
        LiveError
            If the service has ended the capture.
        ValueError
            If there is no such camera.
        """
        with _closed_as_problem():
            try:
                self._connection.send(self.keypoints(camera, time_s, points_px, score))
            except ConnectionClosed:
                # The problem may have come before the end of the connection.
                for message in self._connection:
                    self.read(message)
                raise

    def receive(self, timeout_s: float | None = None) -> LiveInstant | None:
        """Receive the next instant.

        Parameters
        ----------
        timeout_s
            Longest time to wait; ``None``: as long as it takes.

        Returns
        -------
            The instant, whose positions are metres and NaN where unknown; ``None`` if none came in time.

        Raises
        ------
        LiveError
            If the service has ended the capture.
        """
        try:
            with _closed_as_problem():
                message = self.read(self._connection.recv(timeout_s))
        except TimeoutError:
            return None
        return message if isinstance(message, LiveInstant) else None

    def finish(self) -> tuple[list[LiveInstant], CaptureEnd]:
        """End the capture.

        Returns
        -------
            Instants that were still to come, and the end.

        Raises
        ------
        LiveError
            If the service has ended the capture by a problem.
        """
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
    """Begin a live capture at a service, for asynchronous programs.

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
    options
        Choices of the capture.
    key
        Key of the service, if it asks for one.

    Yields
    ------
        The open capture; see ``AsyncLive`` for an example.

    Raises
    ------
    InputError
        If the calibration file can't be read.
    LiveError
        If the service refuses the capture.
    OSError
        If the service can't be reached.
    ValueError
        If the address does not begin with ``http://`` or ``https://``.

    Examples
    --------
    >>> import asyncio
    >>> async def camera_names():
    ...     async with connect(address, calibration, "coco-17", 25.0) as capture:
    ...         await capture.finish()
    ...         return capture.cameras
    >>> asyncio.run(camera_names())
    ('left', 'right')
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
    """Begin a live capture at a service, for loops and threads.

    It has the parameters and errors of ``connect``.

    Yields
    ------
        The open capture; see ``SyncLive`` for an example.

    Examples
    --------
    >>> with connect_sync(address, calibration, "coco-17", 25.0) as capture:
    ...     capture.cameras
    ('left', 'right')
    """
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
