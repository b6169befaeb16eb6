#!/usr/bin/env bash
# OpenCV 5.0.0's SOLVEPNP_SQPNP depends on the unit of length: a cube of 0.8 m has an exact pose in metres, but with the same
# cube in kilometres it raises an assertion (`point_coordinate_variance` or `s_(0) >= 1e-7`). SOLVEPNP_EPNP and
# SOLVEPNP_ITERATIVE find the pose in both units. Scale the points to an extent of 1 before, and the translation after.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.2.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import cv2
import numpy as np

CUBE_M = np.array([[x, y, z] for x in (0, 0.8) for y in (0, 0.8) for z in (0, 0.8)], float) - 0.4
TURN, SHIFT_M = np.array([0.3, -0.2, 0.1]), np.array([0.1, -0.2, 5.0])


def distance_error(unit: float, method: int) -> float | None:
    """Error of the distance in units of the true one; None if OpenCV raises."""
    seen, _ = cv2.projectPoints(CUBE_M, TURN, SHIFT_M, np.eye(3), None)
    try:
        _, _, shift = cv2.solvePnP(CUBE_M * unit, seen, np.eye(3), None, flags=method)
    except cv2.error:
        return None
    return float(np.linalg.norm(shift.ravel() / unit - SHIFT_M) / 5.0)


found = {
    (name, unit): distance_error(factor, getattr(cv2, f"SOLVEPNP_{name}"))
    for name in ("SQPNP", "EPNP", "ITERATIVE")
    for unit, factor in (("m", 1.0), ("km", 1e-3))
}
print("opencv", cv2.__version__)
print("behaviour: error of the distance, None where it raises:", found)
raised = [case for case, error in found.items() if error is None]
as_described = raised == [("SQPNP", "km")] and all(error < 1e-3 for error in found.values() if error is not None)
print("as described" if as_described else "CHANGED")
sys.exit(not as_described)
PYTHON
