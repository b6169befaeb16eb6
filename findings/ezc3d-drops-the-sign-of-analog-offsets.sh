#!/usr/bin/env bash
# ezc3d 1.7.2 takes the absolute value of ANALOG:OFFSET. The format's samples are (sample - OFFSET) * SCALE with a signed
# OFFSET: a sample of 10 with an offset of -30 is 40, as c3d 0.6.0 reads it. ezc3d gives -20.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ezc3d==1.7.2 c3d==0.6.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import struct
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

import c3d
import ezc3d

ANALOG, POINT = 1, 2


def parameter(group: int, name: str, code: int, dimensions: tuple[int, ...], content: bytes) -> bytes:
    value = struct.pack(f"<bB{len(dimensions)}B", code, len(dimensions), *dimensions) + content + b"\0"
    return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<H", 2 + len(value)) + value


def group(number: int, name: str) -> bytes:
    return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<H", 3) + b"\0"


def word(number: int) -> bytes:
    return struct.pack("<h", number)


def real(number: float) -> bytes:
    return struct.pack("<f", number)


# A channel with one sample a frame, two frames, floats; no points.
header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 1, 1, 2, 0, -1.0, 3, 1, 100.0)
parameters = b"".join([
    group(ANALOG, "ANALOG"), group(POINT, "POINT"),
    parameter(ANALOG, "USED", 2, (), word(1)), parameter(ANALOG, "LABELS", -1, (2, 1), b"Fz"),
    parameter(ANALOG, "SCALE", 4, (1,), real(1.0)), parameter(ANALOG, "OFFSET", 2, (1,), word(-30)),
    parameter(ANALOG, "GEN_SCALE", 4, (), real(1.0)), parameter(ANALOG, "RATE", 4, (), real(100.0)),
    parameter(POINT, "USED", 2, (), word(0)), parameter(POINT, "FRAMES", 2, (), word(2)),
    parameter(POINT, "SCALE", 4, (), real(-1.0)), parameter(POINT, "RATE", 4, (), real(100.0)),
    parameter(POINT, "DATA_START", 2, (), word(3)), parameter(POINT, "LABELS", -1, (0, 0), b""),
])
blocks = header, bytes([1, 0x50, 1, 84]) + parameters, real(10.0) + real(20.0)
Path("a.c3d").write_bytes(b"".join(block.ljust(512, b"\0") for block in blocks))
by_ezc3d = ezc3d.c3d("a.c3d")["data"]["analogs"].ravel().tolist()
with open("a.c3d", "rb") as file, warnings.catch_warnings():
    warnings.simplefilter("ignore")
    by_c3d = [float(samples[0, 0]) for _, _, samples in c3d.Reader(file).read_frames()]
print("ezc3d", version("ezc3d"), "c3d", version("c3d"))
print("behaviour: ezc3d", by_ezc3d[:2], "c3d", by_c3d)
as_described = by_ezc3d[:2] == [-20.0, -10.0] and by_c3d == [40.0, 50.0]
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
