"""CSV files: positions of a person's joints in the world, a row a frame, for spreadsheets and statistics.

Columns are ``frame`` (the session's output frame), ``time_s`` (on its clock), and x, y and z of each joint in metres, Z
up. Empty cells are unknown. Numbers are rounded to 0.1 mm and 1 us.
"""

import csv
import io

import numpy as np

from pipeline.data import Timebase, Track3D
from pipeline.joints import JointSet


def encode(track: Track3D, joints: JointSet, timebase: Timebase) -> bytes:
    """Write a track's positions as CSV (RFC 4180).

    Parameters
    ----------
    joints
        Of the track.
    """
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(["frame", "time_s", *(f"{name}_{axis}_m" for name in joints.names for axis in "xyz")])
    for number, xyz_m in enumerate(track.xyz_m, track.start_frame):
        cells = [f"{value:.4f}" if np.isfinite(value) else "" for value in (np.round(xyz_m, 4) + 0.0).ravel()]
        writer.writerow([number, f"{timebase.time_s(number):.6f}", *cells])
    return out.getvalue().encode("utf-8")
