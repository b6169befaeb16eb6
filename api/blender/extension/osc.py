"""Packets of OSC 1.0 (https://opensoundcontrol.stanford.edu/spec-1_0.html): Blender has no library for them.

A packet comes from whoever reaches the port: each length is checked, and bundles nest a few times only.
"""

import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

_BUNDLE = b"#bundle\0"
_TIME_BYTES, _WORD_BYTES = 8, 4
_MAX_DEPTH = 4
_MAX_VALUES = 64


def messages_of(packet: bytes, depth: int = 0) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Address and values of each message of a packet; raises ``ValueError`` where it is no OSC.

    Values are numbers, texts, bytes, booleans and ``None``.
    """
    if not packet.startswith(_BUNDLE):
        yield _message(packet)
        return
    if depth == _MAX_DEPTH:
        raise ValueError("bundles are nested too deeply")
    place = len(_BUNDLE) + _TIME_BYTES
    while place < len(packet):
        content, place = _blob(packet, place)
        yield from messages_of(content, depth + 1)


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
        else:
            raise ValueError("a value is of an unknown type")
    return address, tuple(values)


def _text(packet: bytes, place: int) -> tuple[str, int]:
    """Text that ends with zeros up to a multiple of four bytes, and the place behind it."""
    end = packet.index(b"\0", place)
    return packet[place:end].decode(), end + _WORD_BYTES - end % _WORD_BYTES


def _blob(packet: bytes, place: int) -> tuple[bytes, int]:
    """Bytes behind their number, and the place behind them."""
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
