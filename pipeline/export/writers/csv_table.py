"""CSV files: positions of a person's joints in the world, a row a frame, for spreadsheets and statistics.

Columns are ``frame`` (the session's output frame), ``time_s`` (on its clock), and x, y and z of each joint in metres, Z
up. Empty cells are unknown. Numbers are rounded to 0.1 mm and 1 us.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.data import Timebase, Track3D
from pipeline.export.writers.blocks import fixed, frame_blocks, read_rows
from pipeline.joints import JointSet


def encode(track: Track3D, joints: JointSet, timebase: Timebase) -> Iterator[bytes]:
    """Write a track's positions as CSV (RFC 4180), piece by piece.

    Parameters
    ----------
    joints
        Of the track.
    """
    names = [f"{name}_{axis}_m" for name in joints.names for axis in "xyz"]
    yield (",".join(["frame", "time_s", *names]) + "\r\n").encode("ascii")
    for rows in frame_blocks(track.num_frames):
        places = fixed(track.xyz_m[rows].reshape(-1, len(names)), 4, ",")
        lines = (
            f"{number},{timebase.time_s(number):.6f},{place}\r\n"
            for number, place in enumerate(places, track.start_frame + rows.start)
        )
        yield "".join(lines).replace("nan", "").encode("ascii")


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """World positions of the joints in a file that ``encode`` wrote, some frames at a time."""
    with path.open(encoding="ascii") as file:
        file.readline()
        for values in read_rows(file, ","):
            yield values[:, 2:].reshape(len(values), -1, 3)
