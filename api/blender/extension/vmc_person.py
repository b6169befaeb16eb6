"""Person of a live capture, from messages of the Virtual Motion Capture protocol (https://protocol.vmc.info/english).

Messages have local places and rotations of the bones of Unity's humanoid, in its axes: left-handed, Y up, the rest pose
is a T-pose that faces +Z. Here the axes are the same as in ``glb_motion``: right-handed, Z up, the rest pose faces -Y.

The messages come in packets of OSC 1.0 (https://opensoundcontrol.stanford.edu/spec-1_0.html), for which Blender has no
library. A packet comes from whoever reaches the port: each length is checked, and bundles nest a few times only.
"""

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from api.blender.extension.glb_motion import PersonMotion
from api.blender.extension.turns import NO_TURN, Quat, Vec, length, plus, times, turned, unit_turn
from pipeline.export.character.bone_names import FINGERS, HIPS, REQUIRED, SIDES
from pipeline.motion.skeleton.humanoid import UNITY_BONES

_BUNDLE = b"#bundle\0"
_TIME_BYTES, _WORD_BYTES = 8, 4
_MAX_DEPTH = 4
_MAX_VALUES = 64


def read_messages(packet: bytes, depth: int = 0) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Address and values of each message of a packet; raises ``ValueError`` where it is no OSC.

    Values are numbers, texts, bytes, booleans and ``None``; values of an array are among them.
    """
    if not packet.startswith(_BUNDLE):
        yield _message(packet)
        return
    if depth == _MAX_DEPTH:
        raise ValueError("bundles are nested too deeply")
    place = len(_BUNDLE) + _TIME_BYTES
    while place < len(packet):
        content, place = _blob(packet, place)
        yield from read_messages(content, depth + 1)


def _message(packet: bytes) -> tuple[str, tuple[Any, ...]]:
    address, place = _text(packet, 0)
    tags, place = _text(packet, place)
    if not address.startswith("/") or not tags.startswith(",") or len(tags) > _MAX_VALUES:
        raise ValueError("this is no message")
    values = []
    for tag in tags[1:]:
        if tag in _CONSTANTS:
            values.append(_CONSTANTS[tag])
        elif tag in _READERS:
            value, place = _READERS[tag](packet, place)
            values.append(value)
        elif tag not in "[]":  # values of an array follow each other
            raise ValueError("a value is of an unknown type")
    return address, tuple(values)


def _text(packet: bytes, place: int) -> tuple[str, int]:
    """Text that ends with zeros up to a multiple of four bytes, and the place behind it."""
    end = packet.index(b"\0", place)
    return packet[place:end].decode(), end + _WORD_BYTES - end % _WORD_BYTES


def _blob(packet: bytes, place: int) -> tuple[bytes, int]:
    num_bytes, place = _number(">i", packet, place)
    end = place + num_bytes
    if num_bytes < 0 or end > len(packet):
        raise ValueError("a piece lies outside of the packet")
    return packet[place:end], end + -end % _WORD_BYTES


def _number(form: str, packet: bytes, place: int) -> tuple[Any, int]:
    end = place + struct.calcsize(form)
    if end > len(packet):
        raise ValueError("the packet ends within a number")
    return struct.unpack(form, packet[place:end])[0], end


def _reader(form: str) -> Callable[[bytes, int], tuple[Any, int]]:
    return lambda packet, place: _number(form, packet, place)


_READERS: Mapping[str, Callable[[bytes, int], tuple[Any, int]]] = {
    "s": _text, "S": _text, "b": _blob, "i": _reader(">i"), "f": _reader(">f"), "h": _reader(">q"),
    "d": _reader(">d"), "t": _reader(">Q"), "c": _reader(">I"), "r": _reader(">I"), "m": _reader(">I"),
}  # fmt: skip
_CONSTANTS: Mapping[str, Any] = {"T": True, "F": False, "N": None, "I": float("inf")}


_UPPER_CHEST = "UpperChest"  # Some senders have this bone; Multicap's skeleton lacks it.
_JOINTS = {bone: joint for joint, bone in UNITY_BONES.items()} | {_UPPER_CHEST: _UPPER_CHEST}
_FINGERS = tuple(("Hand", *(f"Hand{finger.capitalize()}{number}" for number in (1, 2, 3))) for finger in FINGERS)
_FINGER_NAMES = {f"{side}Hand{finger.capitalize()}" for side in SIDES for finger in FINGERS}
_LIMBS = ((_UPPER_CHEST, "Shoulder", "Arm", "ForeArm", "Hand"), (HIPS, "UpLeg", "Leg", "Foot"), *_FINGERS)
_TRUNK = (HIPS, "Spine", "Chest", _UPPER_CHEST, "Neck", "Head")
_MAX_NUMBER = 1e4
# Height of the ankle over the floor, as a share of thigh and shin (Winter, "Biomechanics and Motor Control of Human
# Movement", 2009: 0.039 and 0.491 of the stature).
_ANKLE_SHARE = 0.08
_SAME_M = 1e-3


def _parents() -> dict[str, str | None]:
    parents: dict[str, str | None] = dict(zip(_TRUNK, (None, *_TRUNK), strict=False))
    for side in SIDES:
        for above, *joints in _LIMBS:
            above = f"{side}Hand" if above == "Hand" else above  # noqa: PLW2901 - fingers hang on the hand of the side
            for joint in joints:
                parents[f"{side}{joint}"] = above
                above = f"{side}{joint}"  # noqa: PLW2901 - the next joint hangs on it
    return parents


_PARENTS = _parents()


class VmcPerson:
    """Latest pose of a person described by packets."""

    def __init__(self) -> None:
        self._places_m: dict[str, Vec] = {}  # Of joints in their parents
        self._turns: dict[str, Quat] = {}
        self._root: tuple[Vec, Quat] = (0.0, 0.0, 0.0), NO_TURN
        self.is_new = False
        """Return whether bones have come since the last pose."""
        self.time_s: float | None = None
        """Time of the sender, if it states one."""

    def take(self, packet: bytes) -> bool:
        """Take a packet; return whether it is OSC. Messages of other programs and wrong numbers are passed over."""
        try:
            for address, values in read_messages(packet):
                self._take(address, values)
        except ValueError:
            return False
        return True

    def _take(self, address: str, values: tuple[Any, ...]) -> None:
        if address == "/VMC/Ext/T" and len(values) == 1 and type(values[0]) in {float, int}:
            self.time_s = values[0] if math.isfinite(values[0]) else None
        if address not in {"/VMC/Ext/Bone/Pos", "/VMC/Ext/Root/Pos"} or len(values) < 8:
            return
        name, *numbers = values[:8]
        if not all(type(number) in {float, int} and abs(number) <= _MAX_NUMBER for number in numbers):
            return
        x, y, z, qx, qy, qz, qw = numbers
        place_m, turn = (-x, -z, y), unit_turn((qw, qx, qz, -qy))
        if address == "/VMC/Ext/Root/Pos":
            self._root = place_m, turn
        elif (joint := _JOINTS.get(name)) is not None:
            self._places_m[joint], self._turns[joint] = place_m, turn
            self.is_new = True

    @property
    def is_complete(self) -> bool:
        """Return whether all bones have come that an armature needs."""
        return all(joint in self._turns for joint in (HIPS, *REQUIRED))

    def rest(self) -> PersonMotion:
        """Skeleton of the person, without motion; bones of the body that the sender lacks have no length."""
        parents: dict[str, str | None] = {}
        for joint, parent in _PARENTS.items():
            # Fingers stay as they are from the first joint on that lacks.
            if joint[:-1] not in _FINGER_NAMES or (joint in self._places_m and parent in parents):
                parents[joint] = parent
        offsets_m = {joint: self._places_m.get(joint, (0.0, 0.0, 0.0)) for joint in parents}
        legs = [[offsets_m[f"{side}{joint}"] for joint in ("UpLeg", "Leg", "Foot")] for side in SIDES]
        drop_m = -sum(offset[2] for leg in legs for offset in leg) / len(legs)
        legs_m = sum(length(offset) for leg in legs for offset in leg[1:]) / len(legs)
        offsets_m[HIPS] = (0.0, 0.0, drop_m + _ANKLE_SHARE * legs_m)
        return PersonMotion(1.0, parents, offsets_m, (), {})

    def pose(self) -> tuple[Mapping[str, Quat], Vec]:
        """Rotations of the joints in their parents, and the place of the root in metres."""
        self.is_new = False
        root_m, root_turn = self._root
        turns = {**self._turns, HIPS: times(root_turn, self._turns[HIPS])}
        return turns, plus(root_m, turned(root_turn, self._places_m[HIPS]))


def is_same_person(first: PersonMotion, second: PersonMotion) -> bool:
    """Return whether two skeletons have bones of the same lengths."""
    return first.offsets_m.keys() == second.offsets_m.keys() and all(
        abs(a - b) <= _SAME_M
        for joint, offset_m in first.offsets_m.items()
        for a, b in zip(offset_m, second.offsets_m[joint], strict=True)
    )
