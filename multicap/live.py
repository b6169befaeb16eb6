"""Client of live captures: keypoints to a service, people and their skeletons back, while it happens.

``connect`` is asynchronous, ``connect_sync`` is for loops and threads. Instants come as ``LiveInstant``, whose people
have located joints and, once their bones are learnt, a skeleton. ``docs/reference/live-protocol.md`` describes the
protocol.

The examples of this module run against a service at ``address`` with a ``calibration`` of two cameras.
"""

import contextlib
import json
from collections.abc import AsyncIterator, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from websockets.asyncio.client import ClientConnection as AsyncConnection
from websockets.asyncio.client import connect as open_async
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection as SyncConnection
from websockets.sync.client import connect as open_sync

from multicap.live_messages import (
    CaptureEnd,
    CaptureMessages,
    LiveError,
    LiveOptions,
    closed_as_problem,
    read_content,
    refused_as_problem,
    request_headers,
    socket_address,
    start_message,
)
from pipeline.core.paths import StrPath
from pipeline.run.live.records import LiveInstant

__all__ = ["AsyncLive", "CaptureEnd", "LiveError", "LiveOptions", "SyncLive", "connect", "connect_sync"]

_START_S = 180.0
_CLOSE_S = 10.0


class AsyncLive(CaptureMessages):
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
        with closed_as_problem():
            try:
                await self._connection.send(self.keypoints(camera, time_s, points_px, score))
            except ConnectionClosed:
                # The problem may have come before the end of the connection.
                async for message in self._connection:
                    self.read(message)
                raise

    async def finish(self) -> None:
        """End the capture; its last instants still come, and ``end`` is set after them. Raises ``LiveError``."""
        with closed_as_problem():
            await self._connection.send(json.dumps({"type": "end"}))

    async def __aiter__(self) -> AsyncIterator[LiveInstant]:
        """Yield instants until the end of the capture; raises ``LiveError`` if the service ends it by a problem."""
        while self.end is None:
            with closed_as_problem():
                message = self.read(await self._connection.recv())
            if isinstance(message, CaptureEnd):
                self.end = message
            else:
                yield message


class SyncLive(CaptureMessages):
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
        with closed_as_problem():
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
            with closed_as_problem():
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
        with closed_as_problem():
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
    start = start_message(calibration, layout, frame_rate_hz, options)
    with refused_as_problem():
        connection = await open_async(
            socket_address(url),
            additional_headers=request_headers(key),
            max_size=None,
            open_timeout=_START_S,
            close_timeout=_CLOSE_S,
        )
    async with connection:
        with closed_as_problem():
            await connection.send(start)
            ready = read_content(await connection.recv())
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
    start = start_message(calibration, layout, frame_rate_hz, options)
    with refused_as_problem():
        connection = open_sync(
            socket_address(url),
            additional_headers=request_headers(key),
            max_size=None,
            open_timeout=_START_S,
            close_timeout=_CLOSE_S,
        )
    with connection:
        with closed_as_problem():
            connection.send(start)
            ready = read_content(connection.recv())
        yield SyncLive(connection, ready)
