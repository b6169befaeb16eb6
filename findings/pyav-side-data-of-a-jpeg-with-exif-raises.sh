#!/usr/bin/env bash
# PyAV 18.1.0 knows no name for the EXIF data of a picture: `frame.side_data` of a JPEG with EXIF raises ValueError, so
# that its display matrix can't be read there. `frame.rotation` works.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 pillow==12.0.0
"$folder/venv/bin/python" - <<'PYTHON'
import io
import sys

import av
from PIL import Image

exif = Image.Exif()
exif[0x0112] = 6  # orientation: a quarter turn
content = io.BytesIO()
Image.new("RGB", (128, 64)).save(content, "JPEG", exif=exif)
decoder = av.CodecContext.create("mjpeg", "r")
frame = [*decoder.decode(av.Packet(content.getvalue())), *decoder.decode(None)][0]
try:
    error = f"none, {frame.side_data}"
except ValueError as raised:
    error = str(raised)
print("av", av.__version__)
print("behaviour: rotation", frame.rotation, "- error of side_data:", error)
as_described = (frame.rotation, error) == (-90, "31 is not a valid Type")
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
