"""Messages over the pipes between the service and the process of a live capture. Standard library only.

To the process: a length in four bytes and as many bytes. The first message is the start, in JSON, the next ones are
packets of keypoints, and an empty one is the end. From it: a length, the letter of an ``CaptureAnswer``, and the rest.
"""

import enum
import struct
from typing import BinaryIO

LENGTH = struct.Struct("<I")
"""Length of a message, without the four bytes themselves."""


class CaptureAnswer(enum.Enum):
    """Kind of an answer: its first byte."""

    READY = b"R"  # JSON: names of cameras, joints and bones
    REFUSED = b"P"  # JSON: a list of problems; nothing comes after it
    INSTANT = b"I"  # An instant, in the form that the start asks for
    TAKEN = b"T"  # JSON: numbers of frames; a packet was computed, and all its instants were sent
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
