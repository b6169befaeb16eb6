"""Take of a live capture: poses of people as they come, as motions at the scene's frame rate.

Frames lie at the sender's times, so that delays on the way move no key. Between two poses a frame is interpolated; a
person who is missing keeps the last pose.
"""

import struct
from array import array
from collections.abc import Iterator, Mapping

from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.turns import NO_TURN, Quat, Vec, between, plus, scaled

_QUAT = struct.Struct("4f")
# Longest time between two poses that belong together, and longest difference of the clocks of sender and Blender.
_MISSING_S, _CLOCKS_S = 0.25, 0.5
_SAME_S = 1e-4


class _PersonTake:
    """Frames of a person, and the latest pose."""

    def __init__(self, rest: PersonMotion) -> None:
        self.rest = rest
        self.roots_m: list[Vec] = []
        self.turns: dict[str, array[float]] = {}  # An hour of a person takes 100 MB at 30 Hz
        self.last: tuple[float, Mapping[str, Quat], Vec] | None = None

    def add(self, time_s: float, turns: Mapping[str, Quat], root_m: Vec, rate_hz: float) -> None:
        before_s, before, before_m = self.last or (time_s, turns, root_m)
        while (frame_s := self.num_frames / rate_hz) <= time_s + _SAME_S:
            share = 1.0 if frame_s >= time_s - _SAME_S else 0.0
            if before_s < frame_s and time_s - before_s <= _MISSING_S:
                share = min(1.0, (frame_s - before_s) / (time_s - before_s))
            mixed = {joint: between(before.get(joint, turn), turn, share) for joint, turn in turns.items()}
            self._append(mixed, plus(scaled(before_m, 1.0 - share), scaled(root_m, share)))
        self.last = time_s, dict(turns), root_m

    @property
    def num_frames(self) -> int:
        return len(self.roots_m)

    def hold(self, num_frames: int) -> None:
        """Keep the last pose until there are so many frames."""
        while self.last is not None and self.num_frames < num_frames:
            self._append(*self.last[1:])

    def _append(self, turns: Mapping[str, Quat], root_m: Vec) -> None:
        for joint, turn in turns.items():
            if joint not in self.turns:
                self.turns[joint] = array("f", NO_TURN * self.num_frames)
            self.turns[joint].extend(turn)
        self.roots_m.append(root_m)


class LiveTake:
    """Poses of people from a time of Blender's clock on, as frames of a rate."""

    def __init__(self, name: str, rate_hz: float, start_s: float) -> None:
        self.name, self.rate_hz = name, rate_hz
        self._start_s = start_s
        self._behind_s: float | None = None  # Time of the take at which the sender's clock is 0
        self._people: dict[int, _PersonTake] = {}

    def add(
        self, person: int, now_s: float, sent_s: float | None, rest: PersonMotion, pose: tuple[Mapping[str, Quat], Vec]
    ) -> None:
        """Take a pose: rotations of joints in their parents, and the place of the root."""
        time_s = now_s - self._start_s
        if sent_s is not None:
            # A sender that has begun again has another clock.
            if self._behind_s is None or abs(sent_s + self._behind_s - time_s) > _CLOCKS_S:
                self._behind_s = time_s - sent_s
            time_s = sent_s + self._behind_s
        taken = self._people.setdefault(person, _PersonTake(rest))
        taken.rest = rest
        taken.add(time_s, *pose, self.rate_hz)

    def motions(self, now_s: float) -> Iterator[tuple[int, PersonMotion]]:
        """Number and motion of each person who has come, all of the same length, up to a time."""
        until = int((now_s - self._start_s + _SAME_S) * self.rate_hz) + 1
        num_frames = max([until, *(taken.num_frames for taken in self._people.values())])
        for person, taken in self._people.items():
            taken.hold(num_frames)
            turns = {joint: list(_QUAT.iter_unpack(numbers)) for joint, numbers in taken.turns.items()}
            rest = taken.rest
            yield person, PersonMotion(self.rate_hz, rest.parents, rest.offsets_m, taken.roots_m, turns)
