"""Frames of the Qualisys real-time protocol: requests of components, and packets with them.

Numbers are little endian, lengths in millimetres; the world is ours. A receiver knows people by their places in the
parameters that it has read, so each gets the people of its own list. A person who is not in sight has NaN as markers
and a skeleton without segments.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pipeline.motion.skeleton.model import rest_offsets_m
from pipeline.run.live.outputs.poses import FACING_Y, in_segments, product, world_rotations
from pipeline.run.live.outputs.qtm_parameters import segment_joints
from pipeline.run.live.records import LiveInstant, LivePerson

_FRAME, _COMPONENT, _MARKERS = struct.Struct("<qII"), struct.Struct("<II"), struct.Struct("<Ihh")
_TIMECODE = struct.Struct("<IIII")
_CAMERA_TIME, _TICKS_HZ = 2, 10_000_000
_SEGMENT = np.dtype([("id", "<u4"), ("position_mm", "<f4", 3), ("rotation_xyzw", "<f4", 4)])
_UNLABELLED = np.dtype([("position_mm", "<f4", 3), ("id", "<u4")])
_UNLABELLED_RESIDUAL = np.dtype([*_UNLABELLED.descr, ("residual_mm", "<f4")])
_IDS_PER_PERSON = 1000


@dataclass(frozen=True, slots=True)
class FrameRequest:
    """Request of frames: components, rate and, over UDP, the port."""

    components: tuple[str, ...]
    divisor: int = 1  # Every n-th frame
    udp_host: str | None = None  # Address that the request states
    udp_port: int | None = None

    @staticmethod
    def read(words: Sequence[str], rate_hz: float) -> "FrameRequest | None":
        """Read the words of a request in lower case: rate, address of UDP, components; ``None`` if it is wrong.

        ``rate_hz``: rate of the frames, of which the nearest part is sent.
        """
        match = re.fullmatch(r"(allframes|frequency:(\d{1,4})|frequencydivisor:(\d{1,4}))", next(iter(words), ""))
        if match is None:
            return None
        rest = list(words[1:])
        host, port = None, None
        if rest and rest[0].startswith("udp:"):
            host, _, number = rest.pop(0).removeprefix("udp:").rpartition(":")
            if not (number.isdecimal() and len(number) <= 5 and 1 <= int(number) <= 65_535):
                return None
            port = int(number)
        components = read_components(rest)
        if components is None:
            return None
        divisor = round(rate_hz / int(match[2])) if int(match[2] or 0) else int(match[3] or 0)
        return FrameRequest(components, max(1, divisor), host or None, port)


def read_components(words: Sequence[str]) -> tuple[str, ...] | None:
    """Components of a request that exist here; ``None`` if none exists, or a word is no component."""
    names = [word if word == "skeleton:global" else word.partition(":")[0] for word in words]
    if set(names) - _COMPONENTS.keys() - _ABSENT_COMPONENTS:
        return None
    return tuple(dict.fromkeys(name for name in names if name in _COMPONENTS)) or None


_ABSENT_COMPONENTS = {
    *("2d", "2dlin", "6d", "6dres", "6deuler", "6deulerres", "analog", "analogsingle", "force", "forcesingle"),
    *("gazevector", "eyetracker", "image"),
}


class FrameEncoder:
    """Frames of an instant for several receivers: what is equal is computed once.

    ``number``: number of the frame. ``num_joints``: number of the joints of each person.
    """

    def __init__(self, instant: LiveInstant, number: int, num_joints: int) -> None:
        self.number = number & 0xFFFF_FFFF
        self.instant = instant
        self._nowhere_m = np.full((num_joints, 3), np.nan)
        self._people = {person.id: person for person in instant.people}
        self._content: dict[tuple[str, Sequence[int]], bytes] = {}

    def frame(self, components: Sequence[str], people: Mapping[str, Sequence[int]]) -> bytes:
        """Content of a packet with components in their order.

        ``people``: numbers of the people that the receiver knows, as ``3d`` and as ``skeleton``.
        """
        parts = [_FRAME.pack(round(self.instant.time_s * 1e6), self.number, len(components))]
        for name in components:
            kind, encode = _COMPONENTS[name]
            numbers = people["3d" if name.startswith("3d") else "skeleton"]
            if (name, numbers) not in self._content:
                self._content[name, numbers] = encode(self, numbers)
            content = self._content[name, numbers]
            parts += [_COMPONENT.pack(_COMPONENT.size + len(content), kind), content]
        return b"".join(parts)

    def markers(self, numbers: Sequence[int], has_residual: bool) -> bytes:
        """Labelled markers of the people of a list; residuals are unknown."""
        people = [self._people[number].xyz_m if number in self._people else self._nowhere_m for number in numbers]
        position_mm = 1e3 * np.concatenate([self._nowhere_m[:0], *people])
        if has_residual:
            position_mm = np.pad(position_mm, ((0, 0), (0, 1)), constant_values=np.nan)
        return _MARKERS.pack(len(position_mm), 0, 0) + position_mm.astype("<f4").tobytes()

    def unlabelled(self, numbers: Sequence[int], has_residual: bool) -> bytes:
        """Markers of people who are not on a list."""
        dtype = _UNLABELLED_RESIDUAL if has_residual else _UNLABELLED
        others = [_unlabelled(person, dtype) for person in self.instant.people if person.id not in numbers]
        markers = np.concatenate([np.empty(0, dtype), *others])
        return _MARKERS.pack(len(markers), 0, 0) + markers.tobytes()

    def timecode(self, _: Sequence[int]) -> bytes:
        """Time of the cameras, in steps of 100 nanoseconds."""
        ticks = round(self.instant.time_s * _TICKS_HZ) & 0xFFFF_FFFF_FFFF_FFFF
        return _TIMECODE.pack(1, _CAMERA_TIME, ticks >> 32, ticks & 0xFFFF_FFFF)

    def skeletons(self, numbers: Sequence[int], is_global: bool) -> bytes:
        """Skeletons of the people of a list; segments are relative to their parents, or global."""
        poses = _segment_poses(self.instant.people, is_global)
        contents = [poses.get(number, np.empty(0, _SEGMENT)) for number in numbers]
        parts = [struct.pack("<I", len(pose)) + pose.tobytes() for pose in contents]
        return struct.pack("<I", len(numbers)) + b"".join(parts)


def _unlabelled(person: LivePerson, dtype: np.dtype) -> np.ndarray:
    known = np.flatnonzero(np.isfinite(person.xyz_m).all(-1))
    markers = np.empty(len(known), dtype)
    markers["position_mm"], markers["id"] = 1e3 * person.xyz_m[known], person.id * _IDS_PER_PERSON + known
    if dtype is _UNLABELLED_RESIDUAL:
        markers["residual_mm"] = np.nan
    return markers


def _segment_poses(people: Sequence[LivePerson], is_global: bool) -> dict[int, np.ndarray]:
    """Segments by the number of the person."""
    skeletons = {person.id: person.skeleton for person in people if person.skeleton is not None}
    if not skeletons:
        return {}
    num_joints = len(next(iter(skeletons.values())).joint_m)
    places = segment_joints(num_joints)
    if is_global:
        position_m = np.array([skeleton.joint_m for skeleton in skeletons.values()])
        rotation = product(world_rotations(list(skeletons.values())), FACING_Y)
    else:
        offsets_m = np.array([rest_offsets_m(skeleton.bone_length_m) for skeleton in skeletons.values()])
        position_m = in_segments(offsets_m, FACING_Y)
        position_m[:, 0] = [skeleton.root_m for skeleton in skeletons.values()]
        local = np.array([skeleton.parent_from_joint for skeleton in skeletons.values()])
        rotation = product(product(FACING_Y * (-1.0, -1.0, -1.0, 1.0), local), FACING_Y)
        rotation[:, 0] = product(local[:, 0], FACING_Y)
    segments = np.empty((len(skeletons), len(places)), _SEGMENT)
    segments["id"] = np.arange(1, len(places) + 1)
    segments["position_mm"], segments["rotation_xyzw"] = 1e3 * position_m[:, places], rotation[:, places]
    return dict(zip(skeletons, segments, strict=True))


_COMPONENTS: Mapping[str, tuple[int, Callable[[FrameEncoder, Sequence[int]], bytes]]] = MappingProxyType(
    {
        "3d": (1, lambda frame, numbers: frame.markers(numbers, False)),
        "3dnolabels": (2, lambda frame, numbers: frame.unlabelled(numbers, False)),
        "3dres": (9, lambda frame, numbers: frame.markers(numbers, True)),
        "3dnolabelsres": (10, lambda frame, numbers: frame.unlabelled(numbers, True)),
        "timecode": (17, FrameEncoder.timecode),
        "skeleton": (18, lambda frame, numbers: frame.skeletons(numbers, False)),
        "skeleton:global": (18, lambda frame, numbers: frame.skeletons(numbers, True)),
    }
)
