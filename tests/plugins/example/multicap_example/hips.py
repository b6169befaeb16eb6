"""Path of a person's hips: a row a frame with x, y and z in millimetres, and empty cells where it is unknown."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from multicap import PersonContent, Writer


def hips_m(person: PersonContent, frames: range) -> np.ndarray:
    """World positions (metres) of the middle of the hips, (frames, 1, 3); NaN where a hip is unknown."""
    of_track = [person.joints.names.index(f"{side}_hip") for side in ("left", "right")]
    path_m = np.full((len(frames), 1, 3), np.nan)
    for row, frame in enumerate(frames):
        if frame in person.track.frames:
            path_m[row, 0] = person.track.xyz_m[frame - person.track.start_frame, of_track].mean(0)
    return path_m


def encode(person: PersonContent) -> Iterator[bytes]:
    """Write the path."""
    for place_mm in 1000.0 * hips_m(person, person.frames)[:, 0]:
        yield (",".join(f"{part:.2f}" for part in place_mm).replace("nan", "") + "\n").encode()


def read(path: Path) -> Iterator[np.ndarray]:
    """Read the path back in metres."""
    rows = [[float(cell or "nan") for cell in line.split(",")] for line in path.read_text().splitlines()]
    yield np.array(rows)[:, None] / 1000.0


WRITER = Writer(encode, lambda path, preset: read(path), lambda person: lambda frames: hips_m(person, frames))
