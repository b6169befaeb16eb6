"""Messages and packets of live captures, as docs/reference/live-protocol.md describes them. Standard library only.

Messages go over the pipes between the service and the process of a capture. To the process: a length in four bytes and
as many bytes. The first message is the start, in JSON, the next ones are packets of keypoints, and an empty one is the
end. The process of a capture from cameras gets the start and the end only. From it: a length, the letter of a
``CaptureAnswer``, and the rest.

All numbers are little-endian. A packet of keypoints is a head and x, y and score of each point of each person. A packet
of an instant is a head and a record of each person.
"""

import enum
import math
import struct
from typing import BinaryIO, NamedTuple

LENGTH = struct.Struct("<I")
"""Length of a message, without the four bytes themselves."""


class CaptureAnswer(enum.Enum):
    """Kind of an answer: its first byte."""

    READY = b"R"  # JSON: names of cameras, joints and bones
    REFUSED = b"P"  # JSON: a list of problems; nothing comes after it
    INSTANT = b"I"  # An instant, in the form that the start asks for
    TAKEN = b"T"  # JSON: numbers of frames; a packet was computed, and all its instants were sent
    KEPT = b"K"  # A packet of keypoints that were detected, of a capture from cameras
    TOLD = b"S"  # JSON: a message for the client as it is, of a capture from cameras
    END = b"E"  # JSON: numbers of frames; the last message


def framed(content: bytes) -> bytes:
    """Message with its length before it."""
    return LENGTH.pack(len(content)) + content


def read_message(pipe: BinaryIO) -> bytes | None:
    """Next message; ``None`` if the pipe was closed."""
    length = pipe.read(LENGTH.size)
    if len(length) < LENGTH.size:
        return None
    content = pipe.read(num_bytes := LENGTH.unpack(length)[0])
    return content if len(content) == num_bytes else None


KEYPOINTS_MAGIC, INSTANT_MAGIC, PICTURE_MAGIC = b"MCK1", b"MCI1", b"MCP1"
"""First bytes of packets; the digit is the version of the form."""
FLOAT_BYTES = 4
"""Bytes of a coordinate, a score, or a component of a quaternion: IEEE 754, single precision."""
MAX_PX = 1e6
"""Largest absolute value of a coordinate in the picture."""
MAX_TIME_S = 1e10
"""Largest absolute value of a time: seconds since 1970 are below it."""

_KEYPOINTS_HEAD = struct.Struct("<4sHHHHd")
_INSTANT_HEAD = struct.Struct("<4sHHHHdfIII")
_DROPPED_AT = _INSTANT_HEAD.size - 8
# Number and flags of a person.
PERSON_HEAD = struct.Struct("<II")
"""Head of a person's record: the number, and 1 if the skeleton is known."""


class KeypointsHead(NamedTuple):
    """Head of a packet of keypoints."""

    camera: int  # Place of the camera in the list of the message ``ready``
    num_people: int
    num_points: int  # Points of the layout
    time_s: float  # Time of the frame on the cameras' clock

    @property
    def num_bytes(self) -> int:
        """Length of the whole packet."""
        return _KEYPOINTS_HEAD.size + self.num_people * self.num_points * 3 * FLOAT_BYTES

    def encode(self) -> bytes:
        """Bytes of the head."""
        return _KEYPOINTS_HEAD.pack(KEYPOINTS_MAGIC, self.camera, self.num_people, self.num_points, 0, self.time_s)

    @classmethod
    def decode(cls, packet: bytes) -> "KeypointsHead | None":
        """Head of a packet; ``None`` if it is no packet of keypoints, or its length is not the stated one."""
        if len(packet) < _KEYPOINTS_HEAD.size:
            return None
        magic, camera, num_people, num_points, unused, time_s = _KEYPOINTS_HEAD.unpack_from(packet)
        head = cls(camera, num_people, num_points, time_s)
        return head if magic == KEYPOINTS_MAGIC and unused == 0 and len(packet) == head.num_bytes else None

    @staticmethod
    def packet_body(packet: bytes) -> memoryview:
        """Coordinates and scores of a packet."""
        return memoryview(packet)[_KEYPOINTS_HEAD.size :]


_PICTURE_HEAD = struct.Struct("<4sd")


class PhonePicture(NamedTuple):
    """Picture of a phone: a packet is a head and the JPEG."""

    time_s: float  # Time at which it was taken: of phones by the service's clock, to a stream's process of its machine
    jpeg: bytes

    def encode(self) -> bytes:
        """Bytes of the packet."""
        return _PICTURE_HEAD.pack(PICTURE_MAGIC, self.time_s) + self.jpeg

    @classmethod
    def decode(cls, packet: bytes) -> "PhonePicture | None":
        """Picture of a packet; ``None`` if it is no packet of a picture, or its time is not finite."""
        if len(packet) < _PICTURE_HEAD.size:
            return None
        magic, time_s = _PICTURE_HEAD.unpack_from(packet)
        is_right = magic == PICTURE_MAGIC and math.isfinite(time_s)
        return cls(time_s, packet[_PICTURE_HEAD.size :]) if is_right else None


class Dropped(NamedTuple):
    """Messages that were dropped so far because the other side was too slow."""

    input: int = 0  # Frames that waited for the computation for too long
    output: int = 0  # Instants that waited for the client for too long


class InstantHead(NamedTuple):
    """Head of a packet of an instant."""

    num_people: int
    num_joints: int  # Joints of the detector
    num_bones: int  # Joints of the animation skeleton
    time_s: float
    lag_s: float
    sequence: int  # Number of the instant, from 0; it counts dropped ones too
    dropped: Dropped = Dropped()

    @property
    def person_bytes(self) -> int:
        """Length of a person's record: located joints, root, quaternions, lengths and positions of bones."""
        return PERSON_HEAD.size + (3 * self.num_joints + 3 + 8 * self.num_bones) * FLOAT_BYTES

    @property
    def num_bytes(self) -> int:
        """Length of the whole packet."""
        return _INSTANT_HEAD.size + self.num_people * self.person_bytes

    def encode(self) -> bytes:
        """Bytes of the head."""
        return _INSTANT_HEAD.pack(
            INSTANT_MAGIC,
            self.num_people,
            self.num_joints,
            self.num_bones,
            0,
            self.time_s,
            self.lag_s,
            self.sequence,
            *self.dropped,
        )

    @classmethod
    def decode(cls, packet: bytes) -> "InstantHead":
        """Head of a packet; ``ValueError`` if it is no packet of an instant."""
        if len(packet) >= _INSTANT_HEAD.size:
            magic, num_people, num_joints, num_bones, _, time_s, lag_s, sequence, *dropped = _INSTANT_HEAD.unpack_from(
                packet
            )
            head = cls(num_people, num_joints, num_bones, time_s, lag_s, sequence, Dropped(*dropped))
            if magic == INSTANT_MAGIC and len(packet) == head.num_bytes:
                return head
        raise ValueError("These bytes are not a packet of an instant.")

    @staticmethod
    def packet_body(packet: bytes) -> memoryview:
        """Records of the people of a packet."""
        return memoryview(packet)[_INSTANT_HEAD.size :]


def with_dropped(packet: bytes, dropped: Dropped) -> bytes:
    """Packet of an instant with other numbers of dropped messages."""
    changed = bytearray(packet)
    struct.pack_into("<II", changed, _DROPPED_AT, *dropped)
    return bytes(changed)


def encode_keypoints(camera: int, num_points: int, time_s: float, numbers: list[float], num_people: int) -> bytes:
    """Packet of keypoints from x, y and score of each point of each person, in a row."""
    head = KeypointsHead(camera, num_people, num_points, time_s)
    return head.encode() + struct.pack(f"<{len(numbers)}f", *numbers)
