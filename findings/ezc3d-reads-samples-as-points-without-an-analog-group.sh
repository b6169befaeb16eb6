#!/usr/bin/env bash
# ezc3d 1.7.2 takes the analog numbers of a frame from the parameters ANALOG:USED and ANALOG:RATE alone. The header also
# states them, and files without a group ANALOG are in use. ezc3d then reads the samples as points: from the second frame
# on all places are wrong, without an error. c3d 0.6.0 follows the header.
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

POINT = 1


def parameter(name: str, code: int, dimensions: tuple[int, ...], content: bytes) -> bytes:
    value = struct.pack(f"<bB{len(dimensions)}B", code, len(dimensions), *dimensions) + content + b"\0"
    return struct.pack("<bb", len(name), POINT) + name.encode() + struct.pack("<H", 2 + len(value)) + value


def word(number: int) -> bytes:
    return struct.pack("<h", number)


# A point with x = 1, 2, 3 in three frames, beside two analog numbers a frame, which are 90 and 91.
header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 1, 2, 1, 3, 0, -1.0, 3, 1, 100.0)
parameters = b"".join([
    struct.pack("<bb", 5, -POINT) + b"POINT" + word(3) + b"\0",
    parameter("USED", 2, (), word(1)), parameter("FRAMES", 2, (), word(3)),
    parameter("SCALE", 4, (), struct.pack("<f", -1.0)), parameter("RATE", 4, (), struct.pack("<f", 100.0)),
    parameter("DATA_START", 2, (), word(3)), parameter("LABELS", -1, (1, 1), b"P"),
])
frames = b"".join(struct.pack("<6f", frame, 10.0, 20.0, 0.0, 90.0, 91.0) for frame in (1.0, 2.0, 3.0))
blocks = header, bytes([1, 0x50, 1, 84]) + parameters, frames
Path("a.c3d").write_bytes(b"".join(block.ljust(512, b"\0") for block in blocks))
by_ezc3d = ezc3d.c3d("a.c3d")["data"]["points"][:3, 0].T.tolist()
with open("a.c3d", "rb") as file, warnings.catch_warnings():
    warnings.simplefilter("ignore")
    by_c3d = [points[0, :3].tolist() for _, points, _ in c3d.Reader(file).read_frames()]
print("ezc3d", version("ezc3d"), "c3d", version("c3d"))
print("behaviour: ezc3d", by_ezc3d, "c3d", by_c3d)
right = [[1.0, 10.0, 20.0], [2.0, 10.0, 20.0], [3.0, 10.0, 20.0]]
as_described = by_c3d == right and by_ezc3d[0] == right[0] and by_ezc3d[1] == [90.0, 91.0, 2.0]
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
