"""Packets of OSC: those of python-osc, and those of strangers."""

import struct

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder

from api.blender.extension.osc import messages_of

VALUES = [7, 0.25, "Hips", b"12345", True, False, None, "", 2.0]


def packet(depth: int) -> bytes:
    """Packet of python-osc: a message, in so many bundles with a second one in each."""
    message = OscMessageBuilder("/VMC/Ext/Bone/Pos")
    for value in VALUES:
        message.add_arg(value)  # type: ignore[arg-type]
    content: OscMessage | OscBundle = message.build()
    for _ in range(depth):
        bundle = OscBundleBuilder(IMMEDIATELY)
        bundle.add_content(content)
        bundle.add_content(OscMessageBuilder("/VMC/Ext/OK").build())
        content = bundle.build()
    return content.dgram


@pytest.mark.parametrize("depth", [0, 1, 4])
def test_messages_are_those_of_another_library(depth: int) -> None:
    first, *others = messages_of(packet(depth))
    assert first == ("/VMC/Ext/Bone/Pos", tuple(VALUES))
    assert others == [("/VMC/Ext/OK", ())] * depth


WRONG = {
    "empty": b"",
    "too deep": packet(5),
    "no zero": b"/VMC",
    "no address": b"VMC\0,\0\0\0",
    "no tags": b"/VM\0f\0\0\0\0\0\0\0",
    "unknown tag": b"/VM\0,q\0\0",
    "number cut": b"/VM\0,f\0\0\0\0",
    "blob of minus 1": b"/VM\0,b\0\0\xff\xff\xff\xff",
    "blob too long": b"/VM\0,b\0\0\x00\x00\x01\x00",
    "no UTF-8": b"/\xff\xfe\0,\0\0\0",
    "many values": b"/VM\0," + b"T" * 200 + bytes(7),
    "bundle cut": b"#bundle\0" + bytes(8) + struct.pack(">i", 2**31 - 1),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_osc_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        list(messages_of(WRONG[name]))


def test_any_bytes_are_refused_or_read() -> None:
    rng, right = np.random.default_rng(0), packet(2)
    for _ in range(3000):
        changed = bytearray(right)
        for place in rng.integers(0, len(changed), 3).tolist():
            changed[place] = int(rng.integers(0, 256))
        try:
            list(messages_of(bytes(changed[: rng.integers(0, len(changed) + 1)])))
        except ValueError:
            continue
