"""C3D files, as motion capture systems write them: positions of a person's joints as points, millimetres, Z up.

The world's axes are kept; a joint that is unknown in a frame is invalid there (a residual below 0). The file begins at
the person's first frame. Numbers are of single precision, as the format has them.
"""

import tempfile
from pathlib import Path

import ezc3d
import numpy as np

from pipeline.data import Timebase, Track3D
from pipeline.joints import JointSet

_MM_PER_M = 1000.0


def encode(track: Track3D, joints: JointSet, timebase: Timebase) -> bytes:
    """Write a track's positions as C3D.

    Parameters
    ----------
    joints
        Of the track.
    """
    content = ezc3d.c3d()
    point = content["parameters"]["POINT"]
    point["RATE"]["value"] = [timebase.frame_rate_hz]
    point["LABELS"]["value"] = list(joints.names)
    point["UNITS"]["value"] = ["mm"]
    position_mm = np.moveaxis(track.xyz_m, 0, -1).swapaxes(0, 1) * _MM_PER_M
    content["data"]["points"] = np.concatenate([position_mm, np.ones((1, *position_mm.shape[1:]))])
    unknown = np.isnan(position_mm).any(0, keepdims=True)
    content["data"]["meta_points"]["residuals"] = np.where(unknown, -1.0, 0.0)
    # The library writes to a path only.
    with tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        path = Path(folder) / "person.c3d"
        content.write(str(path))
        return path.read_bytes()
