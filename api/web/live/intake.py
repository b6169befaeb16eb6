"""Intake of messages: what clients send is checked here, before anything is computed from it."""

import math
from array import array
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from api.web.errors import ErrorItem, pointer_to
from api.web.http.websockets import WRONG_FIELDS, SocketProblem, wrong_message
from api.web.live import schemas
from api.web.live.problems import too_large
from pipeline.core.problems import request_codes
from pipeline.run.live.packets import MAX_PX, MAX_TIME_S, KeypointsHead, encode_keypoints

_MAX_SHOWN = 40
_MAX_AHEAD_S = 60.0


AnyStart = schemas.LiveStart | schemas.LiveCamerasStart | schemas.LivePatternStart | schemas.LiveRecordStart
"""First message of a client."""
_STARTS: TypeAdapter[AnyStart] = TypeAdapter(Annotated[AnyStart, Field(discriminator="type")])


def read_start(text: str) -> AnyStart:
    """Parse the first message; raises ``SocketProblem`` with all that is wrong."""
    try:
        start = _STARTS.validate_json(text)
    except ValidationError:
        models = (schemas.LiveStart, schemas.LiveCamerasStart, schemas.LivePatternStart, schemas.LiveRecordStart)
        raise wrong_message(text, models, request_codes.LIVE_MESSAGE, request_codes.LIVE_FIELDS) from None
    if isinstance(start, schemas.LivePatternStart | schemas.LiveRecordStart):
        return start
    given = [name for name in ("calibration", "calibration_id") if getattr(start, name) is not None]
    if len(given) != 1:
        code, pointer = (
            (request_codes.UNKNOWN_FIELD, "calibration_id") if given else (request_codes.MISSING_FIELD, "calibration")
        )
        message = "A capture has either a calibration or a calibration_id."
        items = [ErrorItem(code=code, message=message, pointer=pointer_to(pointer))]
        raise SocketProblem(request_codes.LIVE_FIELDS, WRONG_FIELDS, errors=items)
    return start


def wrong_keypoints(text: str) -> SocketProblem:
    """Problem of a text that is no message ``keypoints`` and no ``end``."""
    return wrong_message(
        text, (schemas.LiveKeypoints, schemas.LiveEnd), request_codes.LIVE_MESSAGE, request_codes.LIVE_FIELDS
    )


def read_end(message: Mapping[str, Any]) -> None:
    """Require that a message is ``end``; raises ``SocketProblem``."""
    text = message.get("text") or ""
    try:
        schemas.LiveEnd.model_validate_json(text)
    except ValidationError:
        raise wrong_message(text, (schemas.LiveEnd,), request_codes.LIVE_MESSAGE, request_codes.LIVE_FIELDS) from None


class Intake:
    """Messages with keypoints of one capture as packets; a frame has at most ``max_people``."""

    def __init__(self, cameras: Sequence[str], layout: schemas.Layout, max_people: int) -> None:
        self._places: Mapping[str, int] = {name: place for place, name in enumerate(cameras)}
        self._num_points, self._max_people = schemas.POINTS[layout], max_people
        self._newest_s: float | None = None

    def from_text(self, message: schemas.LiveKeypoints) -> bytes:
        """Packet of a message in JSON; raises ``SocketProblem``."""
        place = self._places.get(message.camera) if isinstance(message.camera, str) else message.camera
        if place is None:
            raise _unknown_camera(message.camera, self._places)
        for person, points in enumerate(message.people):
            if len(points) != self._num_points:
                detail = f"Person {person} has {len(points)} points, and the layout has {self._num_points}."
                raise SocketProblem(request_codes.LIVE_JOINTS, detail)
        self._check(place, len(message.people), message.time_s)
        numbers = [*chain.from_iterable(chain.from_iterable(message.people))]
        return encode_keypoints(place, self._num_points, message.time_s, numbers, len(message.people))

    def from_packet(self, packet: bytes) -> bytes:
        """Packet of a packed message, which is checked; raises ``SocketProblem``."""
        head = KeypointsHead.decode(packet)
        if head is None:
            raise SocketProblem(
                request_codes.LIVE_PACKET, "A packed message is not a packet of keypoints of its stated length."
            )
        if head.num_people and head.num_points != self._num_points:
            detail = f"The packet states {head.num_points} points a person, and the layout has {self._num_points}."
            raise SocketProblem(request_codes.LIVE_JOINTS, detail)
        numbers = array("f", bytes(KeypointsHead.packet_body(packet)))
        # The sum of finite numbers of single precision is finite in double precision; of others it is not.
        if not math.isfinite(sum(numbers)) or not -MAX_TIME_S <= head.time_s <= MAX_TIME_S:
            raise SocketProblem(
                request_codes.LIVE_PACKET, "A number of the packet is not finite, or the time is out of range."
            )
        scores = numbers[2::3]
        if numbers and not (
            min(scores) >= 0.0 and max(scores) <= 1.0 and min(numbers) >= -MAX_PX and max(numbers) <= MAX_PX
        ):
            detail = f"Coordinates are within {MAX_PX:,.0f} pixels, scores from 0 to 1."
            raise SocketProblem(request_codes.LIVE_PACKET, detail)
        self._check(head.camera, head.num_people, head.time_s)
        return packet

    def _check(self, camera: int, num_people: int, time_s: float) -> None:
        if camera >= len(self._places):
            raise _unknown_camera(camera, self._places)
        if num_people > self._max_people:
            detail = f"A frame has {num_people} people; at most {self._max_people} are allowed."
            raise SocketProblem(request_codes.LIVE_TOO_LARGE, detail)
        if self._newest_s is not None and time_s > self._newest_s + _MAX_AHEAD_S:
            ahead_s = time_s - self._newest_s
            detail = f"A frame is {ahead_s:.1f} s ahead of all others; at most {_MAX_AHEAD_S:g} s are allowed."
            raise SocketProblem(request_codes.LIVE_TIME, detail)
        self._newest_s = time_s if self._newest_s is None else max(time_s, self._newest_s)


def require_size(message: Mapping[str, Any], max_bytes: int) -> None:
    """Raise ``SocketProblem`` for a message of more bytes than allowed."""
    content = message.get("bytes") or message.get("text") or b""
    if len(content) > max_bytes:
        raise too_large(max_bytes)


def _unknown_camera(camera: str | int, names: Mapping[str, int]) -> SocketProblem:
    shown = repr(camera[:_MAX_SHOWN]) if isinstance(camera, str) else str(camera)
    known = ", ".join([name[:_MAX_SHOWN] for name in names][:8])
    return SocketProblem(request_codes.LIVE_CAMERA, f"The calibration has no camera {shown}; it has {known}.")
