#!/usr/bin/env bash
# aniposelib: CameraGroup.load returns more than ten cameras in another order than CameraGroup.dump wrote them.
# One guesses that a file that aniposelib wrote is read as the same group, so that arrays of points keep their cameras.
# It sorts the sections as text: cam_0, cam_1, cam_10, cam_11, cam_2, ... Points in the order of the group that was
# dumped then meet other cameras, and triangulated points are half a metre off here, without an error or a warning.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --disable-pip-version-check aniposelib==0.8.0 toml==0.10.2
"$folder/venv/bin/python" - "$folder/rig.toml" <<'PYTHON'
import sys
from importlib.metadata import version

import cv2
import numpy as np
from aniposelib.cameras import Camera, CameraGroup


def camera(number: int) -> Camera:
    """Camera of a ring at 4 m that looks at the middle."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]) @ cv2.Rodrigues(np.array([0.0, 0.0, 0.5 * number]))[0]
    matrix = np.array([[1000.0, 0.0, 640.0], [0.0, 1000.0, 360.0], [0.0, 0.0, 1.0]])
    rvec = cv2.Rodrigues(turn)[0].ravel()
    return Camera(matrix, np.zeros(5), (1280, 720), rvec, np.array([0.0, 0.0, 4.0]), f"view{number:02}")


points = np.random.default_rng(1).uniform(-0.5, 0.5, (10, 3))
print("aniposelib", version("aniposelib"))
for count, is_kept in ((10, True), (12, False)):
    group = CameraGroup([camera(number) for number in range(count)])
    pixels = np.array([one.project(points).reshape(-1, 2) for one in group.cameras])
    group.dump(sys.argv[1])
    loaded = CameraGroup.load(sys.argv[1])
    off = [float(np.linalg.norm(one.triangulate(pixels) - points, axis=1).max()) for one in (group, loaded)]
    print(f"{count} cameras: loaded as {loaded.get_names()}")
    print(f"  points are off by {off[0]:.4f} m with the group that was dumped, by {off[1]:.4f} m with the loaded one")
    assert off[0] < 1e-3, "the group that was dumped is wrong"
    assert (loaded.get_names() == group.get_names()) == is_kept, "the order has changed its behaviour"
    assert (off[1] < 1e-3) == is_kept, "the points have changed their behaviour"
PYTHON
