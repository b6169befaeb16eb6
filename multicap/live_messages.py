"""Messages of a live capture between a client and a service: what starts it, frames, instants, its end, problems."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit
from uuid import UUID

import numpy as np
from jaxtyping import Float
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import CloseCode

from pipeline.calibration.registry import read_calibration
from pipeline.calibration.write import encode
from pipeline.core.parsing import UnreadableError, read_json
from pipeline.core.paths import StrPath
from pipeline.core.problems.request_codes import LIVE_STOPPED
from pipeline.run.live.packets import Dropped
from pipeline.run.live.packing import instant_of_json, pack_keypoints, unpack_instant
from pipeline.run.live.records import LiveInstant

_VERSIONS: Mapping[str, str] = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}


class LiveError(Exception):
    """The service refused or ended a capture.

    Parameters
    ----------
    code
        Code of docs/reference/problems.md.
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
    """Choices of a capture; docs/reference/live-protocol.md describes them.

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


class CaptureMessages:
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
        content = read_content(message)
        if content["type"] == "ended":
            self.dropped = Dropped(**content["dropped"])
            return CaptureEnd(content["counts"], self.dropped, content["session_id"], content["kept_frames"])
        instant, self.dropped = instant_of_json(content)
        return instant


def socket_address(url: str) -> str:
    """Address of live captures at a service."""
    parts = urlsplit(url)
    if parts.scheme not in _VERSIONS:
        raise ValueError("The address of a service begins with http:// or https://.")
    return urlunsplit((_VERSIONS[parts.scheme], parts.netloc, parts.path.rstrip("/") + "/v1/live", "", ""))


def request_headers(key: str | None) -> dict[str, str]:
    """Headers of the request that opens the WebSocket."""
    return {} if key is None else {"Authorization": f"Bearer {key}"}


def start_message(
    calibration: StrPath | Mapping[str, Any], layout: str, frame_rate_hz: float, options: LiveOptions
) -> str:
    """Encode the message that starts a capture."""
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


def read_content(message: str | bytes) -> dict[str, Any]:
    """Content of a message in JSON; raises ``LiveError`` for a problem."""
    content: dict[str, Any] = json.loads(message)
    if content["type"] == "problem":
        raise LiveError(content["code"], content["detail"], content)
    return content


@contextlib.contextmanager
def closed_as_problem() -> Iterator[None]:
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
def refused_as_problem() -> Iterator[None]:
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
