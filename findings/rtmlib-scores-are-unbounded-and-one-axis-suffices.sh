#!/usr/bin/env bash
# rtmlib decodes SimCC: a joint's score is the plain mean of the highest raw outputs of both axes. It is no confidence:
# scores of 8 come out, and a joint whose y has no positive output at all has a score of 2 if x has one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.2.6
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps rtmlib==0.0.13
"$folder/venv/bin/python" - <<'PYTHON'
import importlib.util
import sys
from importlib.metadata import distribution, version

import numpy as np

# The module alone: the package imports ONNX Runtime and OpenCV, which decoding does not need.
path = distribution("rtmlib").locate_file("rtmlib/tools/pose_estimation/post_processings.py")
spec = importlib.util.spec_from_file_location("post_processings", path)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)

x = np.full((1, 2, 16), -3.0, np.float32)
y = np.full((1, 2, 16), -3.0, np.float32)
x[0, 0, 5], y[0, 0, 9] = 8.0, 8.0  # seen on both axes
x[0, 1, 5] = 7.0  # y is negative everywhere
places, scores = module.get_simcc_maximum(x, y)
print("rtmlib", version("rtmlib"))
print("behaviour: scores are means of raw outputs, above 1, and one axis is enough for a positive score")
print("places", places.tolist(), "scores", scores.tolist())
sys.exit(0 if scores.tolist() == [[8.0, 2.0]] and places[0, 1].tolist() == [5.0, 0.0] else 1)
PYTHON
