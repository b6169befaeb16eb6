#!/usr/bin/env bash
# OpenCV 5.0.0 reads no RGB TIFF whose orientation is a quarter turn (5 to 8): `cv2.imread` returns None without a word,
# also with IMREAD_IGNORE_ORIENTATION and IMREAD_UNCHANGED. Orientations 1 to 4 are read.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 pillow==12.0.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
from PIL import Image

FLAGS = (cv2.IMREAD_COLOR, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, cv2.IMREAD_UNCHANGED)
read = {}
for orientation in range(1, 9):
    Image.new("RGB", (128, 64), "white").save("a.tif", tiffinfo={274: orientation})
    read[orientation] = [image is not None for image in (cv2.imread("a.tif", flags) for flags in FLAGS)]
print("opencv", cv2.__version__)
print("behaviour: read, by orientation and flags:", read)
as_described = all(is_read == [orientation < 5] * 3 for orientation, is_read in read.items())
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
