"""Joint angles in tables: CSV for spreadsheets and statistics, and MOT, the form of OpenSim's motion files.

A CSV file has the columns ``frame`` (output frame of the session) and ``time_s`` (on the session's clock), each angle
of ``pipeline.angles`` in degrees, and then the standard deviation of each. Cells of unknown angles are empty. A MOT
file has ``time`` and the angles; unknown ones are ``nan``. So is everything in frames before and after the track.
Numbers are rounded to 0.001 degrees and 1 us.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.angles.compute import JointAngles
from pipeline.angles.definitions import ANGLE_NAMES
from pipeline.data.cameras import Timebase
from pipeline.export.timelines import unknown_outside
from pipeline.export.writers.blocks import fixed, frame_blocks, read_rows

_DECIMALS = 3
_END_OF_HEAD = "endheader"


def with_sigmas(angles: JointAngles) -> Float[np.ndarray, "frames columns"]:
    """Columns of a CSV file: angles in degrees, then their standard deviations."""
    return np.concatenate([angles.angle_deg, angles.sigma_deg], axis=1)


def encode_csv(angles: JointAngles, timebase: Timebase, frames: range) -> Iterator[bytes]:
    """Write a person's angles as CSV (RFC 4180), piece by piece; ``frames`` are the output frames of the file."""
    names = [*(f"{name}_deg" for name in ANGLE_NAMES), *(f"{name}_sigma_deg" for name in ANGLE_NAMES)]
    yield (",".join(["frame", "time_s", *names]) + "\r\n").encode("ascii")
    for rows, cells in _blocks(with_sigmas(angles), angles.frames, frames, ","):
        lines = (
            f"{number},{timebase.time_s(number):.6f},{row}\r\n" for number, row in zip(frames[rows], cells, strict=True)
        )
        yield "".join(lines).replace("nan", "").encode("ascii")


def encode_mot(angles: JointAngles, timebase: Timebase, file_name: str, frames: range) -> Iterator[bytes]:
    """Write a person's angles as an OpenSim motion, piece by piece; ``frames`` are the output frames of the file."""
    head = (
        file_name,
        "version=1",
        f"nRows={len(frames)}",
        f"nColumns={1 + len(ANGLE_NAMES)}",
        "inDegrees=yes",
        _END_OF_HEAD,
        "\t".join(["time", *ANGLE_NAMES]),
    )
    yield "".join(f"{line}\n" for line in head).encode("utf-8")
    for rows, cells in _blocks(angles.angle_deg, angles.frames, frames, "\t"):
        lines = (f"{timebase.time_s(number):.6f}\t{row}\n" for number, row in zip(frames[rows], cells, strict=True))
        yield "".join(lines).encode("ascii")


def read_csv(path: Path) -> Iterator[Float[np.ndarray, "rows columns 1"]]:
    """Read angles and standard deviations in degrees from a file of ``encode_csv``, block by block; NaN where empty."""
    with path.open(encoding="ascii") as file:
        file.readline()
        for values in read_rows(file, ","):
            yield values[:, 2:, None]


def read_mot(path: Path) -> Iterator[Float[np.ndarray, "rows columns 1"]]:
    """Read angles in degrees from a file of ``encode_mot``, block by block; NaN where unknown."""
    with path.open(encoding="utf-8") as file:
        while (line := file.readline()) and line.rstrip("\n") != _END_OF_HEAD:
            pass
        file.readline()
        for values in read_rows(file, "\t"):
            yield values[:, 1:, None]


def _blocks(
    values: Float[np.ndarray, "rows columns"], of_frames: range, frames: range, separator: str
) -> Iterator[tuple[slice, list[str]]]:
    """Rows of the frames of a file, and their numbers as text, block by block."""
    for rows in frame_blocks(len(frames)):
        yield rows, fixed(unknown_outside(values, of_frames, frames[rows]), _DECIMALS, separator)
