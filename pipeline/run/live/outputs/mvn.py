"""Xsens MVN: people as characters of its network stream, datagrams over UDP.

Protocol: "MVN real-time network streaming protocol specification", Xsens Technologies. Numbers are big endian, lengths
in metres; the world is ours, Z up and right-handed. Segments have the axes of MVN: in the rest pose X points ahead and
Y to the left. ``L3`` and ``T12`` divide our lower spine; a toe begins at the tip of ours, and a finger's metacarpal
bone at the wrist. A character has one person until the person has been gone for two seconds.

Poses and time codes go at every instant; names and rest poses every second, because receivers may start late.
"""

import struct
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from pipeline.motion.skeleton.model import INDEX, SKELETON
from pipeline.run.live.outputs.datagrams import DatagramOutput
from pipeline.run.live.outputs.output import OutputStart
from pipeline.run.live.outputs.poses import (
    FACING_X,
    in_segments,
    person_colour,
    person_name,
    product,
    rest_joints_m,
    world_rotations,
)
from pipeline.run.live.records import LiveInstant, LivePerson, LiveSkeleton

_HEADER = struct.Struct(">6sIBBIBBBBHH")
_POSE = np.dtype([("id", ">u4"), ("position_m", ">f4", 3), ("rotation_wxyz", ">f4", 4)])
_POSES, _NAMES, _REST, _TIMECODE = 2, 12, 13, 25
# Counters of datagrams: the first of several, the second and last of two, the only one.
_FIRST, _SECOND_LAST, _ONLY = 0, 0x81, 0x80
_FACTS_S = 1.0
_DAY_MS = 86_400_000

_ARM, _LEG = ("Shoulder", "UpperArm", "ForeArm", "Hand"), ("UpperLeg", "LowerLeg", "Foot", "Toe")
_OUR_ARM, _OUR_LEG = ("Shoulder", "Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "FootEnd")
_FINGERS = {"Second": "Index", "Third": "Middle", "Fourth": "Ring", "Fifth": "Pinky"}
_L3, _T12, _T8 = 2, 3, 4


def _limb(names: tuple[str, ...], joints: tuple[str, ...]) -> list[tuple[str, str]]:
    pairs = list(zip(names, joints, strict=True))
    return [(side + name, side + joint) for side in ("Right", "Left") for name, joint in pairs]


def _hand(side: str) -> Iterator[tuple[str, str]]:
    hand = f"{side}Hand"
    yield f"{side}Carpus", hand
    for place, bone in enumerate(("MC", "PP", "DP"), 1):
        yield f"{side}First{bone}", f"{hand}Thumb{place}"
    for number, finger in _FINGERS.items():
        yield f"{side}{number}MC", hand
        for place, bone in enumerate(("PP", "MP", "DP"), 1):
            yield f"{side}{number}{bone}", f"{hand}{finger}{place}"


# Segments in the order of their numbers, each with the joint that turns it and at which it begins.
_BODY = [
    *(("Pelvis", "Hips"), ("L5", "Spine"), ("L3", "Spine"), ("T12", "Spine"), ("T8", "Chest")),
    *(("Neck", "Neck"), ("Head", "Head"), *_limb(_ARM, _OUR_ARM), *_limb(_LEG, _OUR_LEG)),
]
_HANDS = [*_hand("Left"), *_hand("Right")]


def _segments(num_joints: int) -> list[tuple[str, str]]:
    return _BODY if num_joints == len(SKELETON) else _BODY + _HANDS


def _origins_m(joint_m: Float[np.ndarray, "*any joints 3"]) -> Float[np.ndarray, "*any segments 3"]:
    """Origins of the segments for positions of joints."""
    origins_m = joint_m[..., [INDEX[joint] for _, joint in _segments(joint_m.shape[-2])], :]
    step_m = (origins_m[..., _T8, :] - origins_m[..., _L3, :]) / 3
    origins_m[..., _L3, :] += step_m
    origins_m[..., _T12, :] += 2 * step_m
    return origins_m


def _text(text: str) -> bytes:
    return struct.pack(">I", len(text.encode())) + text.encode()


class MvnOutput(DatagramOutput):
    """Output of the network stream of MVN; see ``LiveOutput``."""

    def __init__(self, start: OutputStart) -> None:
        super().__init__(start)
        self._told: dict[int, tuple[int, float]] = {}  # Person of a character, and time of the last name and rest pose

    def packets(self, instant: LiveInstant) -> Iterator[tuple[int, bytes]]:
        """See ``DatagramOutput``."""
        time_s, elapsed_s = instant.time_s, self.elapsed_s(instant)
        sample, elapsed_ms = round(elapsed_s * self.rate_hz), round(1e3 * elapsed_s)
        characters = {
            number: (person, person.skeleton)
            for number, person in enumerate(self.slots.update(instant))
            if person is not None and person.skeleton is not None
        }
        if not characters:
            return
        rotations = product(world_rotations([skeleton for _, skeleton in characters.values()]), FACING_X)
        for (number, (person, skeleton)), rotation in zip(characters.items(), rotations, strict=True):
            segments = _segments(len(rotation))
            counts = len(_BODY), 0, len(segments) - len(_BODY), 0
            for kind, counter, content in self._contents(number, person, skeleton, rotation, time_s):
                head = f"MXTP{kind:02}".encode(), sample & 0xFFFF_FFFF, counter, len(segments), elapsed_ms & 0xFFFF_FFFF
                yield self.address.port, _HEADER.pack(*head, number, *counts, len(content)) + content

    def _contents(
        self, number: int, person: LivePerson, skeleton: LiveSkeleton, rotation: np.ndarray, time_s: float
    ) -> Iterator[tuple[int, int, bytes]]:
        """Types, counters and contents of the datagrams of a character."""
        told, told_s = self._told.get(number, (0, 0.0))
        if told != person.id or time_s - told_s >= _FACTS_S:
            self._told[number] = person.id, time_s
            yield _NAMES, _ONLY, _facts(person)
            yield _REST, _FIRST, _rest_pose(skeleton)
            yield _REST, _SECOND_LAST, bytes(8)  # no further segments, no points
        yield _TIMECODE, _ONLY, _text(_timecode(time_s))
        yield _POSES, _ONLY, _pose(skeleton, rotation)


def _pose(skeleton: LiveSkeleton, rotation: Float[np.ndarray, "joints 4"]) -> bytes:
    segments = _segments(len(rotation))
    items = np.empty(len(segments), _POSE)
    items["id"] = np.arange(1, len(segments) + 1)
    items["position_m"] = _origins_m(skeleton.joint_m)
    items["rotation_wxyz"] = rotation[[INDEX[joint] for _, joint in segments]][:, [3, 0, 1, 2]]
    return items.tobytes()


def _rest_pose(skeleton: LiveSkeleton) -> bytes:
    """Origins of the segments in the rest pose, which faces X, and no points."""
    segments = _segments(len(skeleton.bone_length_m))
    origins_m = _origins_m(in_segments(rest_joints_m(skeleton.bone_length_m), FACING_X))
    items = [_text(name) + struct.pack(">3f", *xyz) for (name, _), xyz in zip(segments, origins_m, strict=True)]
    return struct.pack(">I", len(segments)) + b"".join(items) + struct.pack(">I", 0)


def _facts(person: LivePerson) -> bytes:
    # A receiver takes the length and the first tag for one, so that the tag which matters least comes first.
    red, green, blue = person_colour(person.id)
    colour = f"{red:02X}{green:02X}{blue:02X}"
    return _text(f"xmid:{person.id}\nname:{person_name(person.id)}\ncolor:{colour}\ntimeOffset:0\n")


def _timecode(time_s: float) -> str:
    seconds, milliseconds = divmod(round(1e3 * time_s) % _DAY_MS, 1000)
    return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}.{milliseconds:03}"
