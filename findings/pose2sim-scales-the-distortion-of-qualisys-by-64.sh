#!/usr/bin/env bash
# Pose2Sim: its converters between Qualisys's QCA and TOML multiply and divide the distortion by 64.
# One guesses that only focal lengths and principal points are counted in 1/64 pixel, since a distortion has no unit.
# calib_toml_to_qca writes k1 = -0.1 as -6.4, and calib_qca_to_toml reads -0.1 as -0.0015625: the lens of a TOML file
# made of a Qualisys calibration is nearly straight. There and back the distortion is right. fov_video ends at the width
# and height in place of the last pixel's number, so that a program that reads QCA finds a picture one pixel too large.
# calib_qca_to_toml also divides the positions by 1000 twice: 4 m in millimetres become 0.004.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
# The two converters need these packages alone.
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps pose2sim==0.10.49
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check lxml==6.0.2 rtoml==0.12.0 \
    numpy==2.2.6 opencv-python-headless==4.12.0.88
cd "$folder"
cat > rig.toml <<'TOML'
[left]
name = "left"
size = [ 1920, 1080]
matrix = [ [ 1450.0, 0.0, 951.5], [ 0.0, 1460.0, 548.25], [ 0.0, 0.0, 1.0]]
distortions = [ -0.1, 0.05, 0.001, -0.002]
rotation = [ 1.2, 0.1, -0.3]
translation = [ 0.1, -0.2, 4.0]
fisheye = false
TOML
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import types
from importlib.metadata import version
from xml.etree import ElementTree

import numpy as np
import rtoml
from pathlib import Path

# Pose2Sim.common loads the whole program for the order of names.
common = types.ModuleType("Pose2Sim.common")
common.natural_sort_key = str
sys.modules["Pose2Sim.common"] = common
from Pose2Sim.Utilities.calib_qca_to_toml import calib_qca_to_toml_func
from Pose2Sim.Utilities.calib_toml_to_qca import calib_toml_to_qca_func

print("pose2sim", version("pose2sim"))
calib_toml_to_qca_func(input_file="rig.toml", output_file="rig.qca.txt")
camera = ElementTree.parse("rig.qca.txt").find("cameras/camera")
lens, area = camera.find("intrinsic"), camera.find("fov_video")
k1, right, bottom = float(lens.get("radialDistortion1")), float(area.get("right")), float(area.get("bottom"))
print(f"TOML to QCA: k1 = -0.1 becomes {k1}; 1920 x 1080 becomes left 0, right {right:g}, top 0, bottom {bottom:g}")
assert np.isclose(k1, -6.4) and (right, bottom) == (1920, 1080)
# The same file with the numbers of a Qualisys camera.
text = Path("rig.qca.txt").read_text().replace(str(lens.get("radialDistortion1")), "-0.1")
Path("qualisys.qca.txt").write_text(text.replace('right="1920" bottom="1080"', 'right="1919" bottom="1079"'))
calib_qca_to_toml_func({"input_file": "qualisys.qca.txt", "binning_factor": 1, "output_file": "read.toml"})
read = next(value for name, value in rtoml.load(Path("read.toml")).items() if name != "metadata")
print(f"QCA to TOML: k1 = -0.1 becomes {read['distortions'][0]}; size {read['size']}; translation {read['translation']}")
assert np.isclose(read["distortions"][0], -0.1 / 64)
assert np.isclose(np.linalg.norm(read["translation"]), np.linalg.norm([0.1, -0.2, 4.0]) / 1000)
PYTHON
