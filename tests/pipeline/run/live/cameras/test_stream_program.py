"""Times of the frames of a stream whose own times jump."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from types import SimpleNamespace
from typing import Any, cast

from pipeline.run.live.cameras.stream_program import StreamRequest, _Stream, _Taken
from tests.type_checker import of_wrong_types

TICK = Fraction(1, 1000)


@dataclass
class StampedFrame:
    """Frame with its time in ticks."""

    pts: int


class StampedPacket:
    """Packet from which the decoder gives the frame of the packet before, as it does where frames are reordered."""

    is_keyframe, size = True, 1

    def __init__(self, pts: int, before: int | None) -> None:
        self.pts, self._before = pts, before

    def decode(self) -> list[StampedFrame]:
        return [] if self._before is None else [StampedFrame(self._before)]


@of_wrong_types
def test_frame_from_before_jump_is_not_waited_for() -> None:
    """The camera counts anew from 0; the last frame from before would be due in a day."""
    stamps = [86_400_000, 86_400_040, 0, 40, 80]

    def demux(_stream: object) -> Iterator[StampedPacket]:
        for pts, before in zip(stamps, [None, *stamps], strict=False):
            yield StampedPacket(pts, before)
            time.sleep(0.04)

    container = SimpleNamespace(format=SimpleNamespace(name="rtsp"), demux=demux)
    stream = _Stream(StreamRequest("rtsp", "rtsp://127.0.0.1/", (64, 48)))
    stream._newest = cast(_Taken, object())  # a stream that was opened
    timed = list(stream._timed_frames(cast(Any, container), cast(Any, SimpleNamespace(time_base=TICK))))
    assert len(timed) >= 3
    assert all(time_s <= time.monotonic() for time_s, _ in timed)
