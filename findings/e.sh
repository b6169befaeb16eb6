#!/usr/bin/env bash
# Two behaviours of libraries that read still images with an orientation; exits non-zero if one of them changes.
#
# 1. PyAV 18.1.0: `frame.side_data` of a JPEG with EXIF data raises "31 is not a valid Type", also for its display matrix.
# 2. opencv-python-headless 5.0.0.93: `cv2.imread` returns None for an RGB TIFF of orientation 5, 6, 7 or 8 (a quarter
#    turn), also with `cv2.IMREAD_IGNORE_ORIENTATION` and `cv2.IMREAD_UNCHANGED`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 opencv-python-headless==5.0.0.93
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import struct
import sys
from pathlib import Path

import av
import cv2
import numpy as np

print("av", av.__version__, "opencv", cv2.__version__)
image = np.zeros((64, 128, 3), np.uint8)
image[:32, :64] = 255

jpeg = cv2.imencode(".jpg", image)[1].tobytes()
exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06" + bytes(6)
content = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
decoder = av.CodecContext.create("mjpeg", "r")
frame = [*decoder.decode(av.Packet(content)), *decoder.decode(None)][0]
try:
    error = None
    frame.side_data
except ValueError as raised:
    error = str(raised)
print("JPEG with EXIF orientation 6: frame.rotation", frame.rotation, "- frame.side_data raises:", error)


def tiff(orientation):
    entries = [(256, 4, 1, 128), (257, 4, 1, 64), (258, 3, 3, 134), (259, 3, 1, 1), (262, 3, 1, 2), (273, 4, 1, 140)]
    entries += [(274, 3, 1, orientation), (277, 3, 1, 3), (278, 4, 1, 64), (279, 4, 1, image.size)]
    directory = struct.pack("<H", 10) + b"".join(struct.pack("<HHII", *entry) for entry in entries) + bytes(4)
    return struct.pack("<2sHI", b"II", 42, 8) + directory + struct.pack("<3H", 8, 8, 8) + image.tobytes()


read, ignored = {}, {}
for orientation in range(1, 9):
    Path("a.tif").write_bytes(tiff(orientation))
    shown, stored = cv2.imread("a.tif"), cv2.imread("a.tif", cv2.IMREAD_UNCHANGED)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    assert (cv2.imread("a.tif", flags) is None) == (shown is None)
    read[orientation] = None if shown is None else shown.shape
    ignored[orientation] = None if stored is None else stored.shape
print("TIFF by orientation, cv2.imread:", read)
print("with IMREAD_UNCHANGED:", ignored)
as_described = (
    error == "31 is not a valid Type"
    and frame.rotation == -90
    and all((read[orientation] is None) == (orientation > 4) for orientation in read)
    and all((ignored[orientation] is None) == (orientation > 4) for orientation in ignored)
)
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
