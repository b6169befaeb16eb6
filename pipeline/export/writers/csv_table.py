"""CSV files: world positions of a person's joints, a row a frame, for spreadsheets and statistics.

Columns are ``frame`` (output frame of the session), ``time_s`` (on the session's clock), and x, y and z of each joint
in metres, Z up. Cells of unknown joints are empty; so are all cells in frames before and after the track.
Numbers are rounded to 0.1 mm and 1 us.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.association.own_points.rigid import RigidMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.export.timelines import fixed, frame_blocks, read_rows, unknown_outside
from pipeline.export.writers.registry import Writer, joint_positions


def encode(track: Track3D, joints: JointSet, timebase: Timebase, frames: range | None = None) -> Iterator[bytes]:
    """Write a track's positions as CSV (RFC 4180), piece by piece.

    ``track``: world positions (frames, joints, 3) in metres, Z up; NaN where a joint is unknown, which is an empty
    cell. ``frames``: output frames of the file; ``None``: the track's frames. Joints are unknown outside the track's
    frames.

    >>> from pipeline.core.joints import COCO_17
    >>> known, zeros = np.zeros((2, 17, 3)), np.zeros((2, 17))
    >>> track = Track3D(1, 0, known, zeros, zeros.astype(np.int8), zeros, zeros.astype(int))
    >>> b"".join(encode(track, COCO_17, Timebase(0.0, 30.0, 2))).decode().splitlines()[2][:27]
    '1,0.033333,0.0000,0.0000,0.'
    """
    frames = track.frames if frames is None else frames
    names = [f"{name}_{axis}_m" for name in joints.names for axis in "xyz"]
    yield (",".join(["frame", "time_s", *names]) + "\r\n").encode("ascii")
    for rows in frame_blocks(len(frames)):
        xyz_m = unknown_outside(track.xyz_m, track.frames, frames[rows])
        places = fixed(xyz_m.reshape(-1, len(names)), 4, ",")
        lines = (
            f"{number},{timebase.time_s(number):.6f},{place}\r\n"
            for number, place in zip(frames[rows], places, strict=True)
        )
        yield "".join(lines).replace("nan", "").encode("ascii")


def encode_rigid(motions: Sequence[RigidMotion], timebase: Timebase) -> Iterator[bytes]:
    """Write the poses of rigid objects as CSV, piece by piece: place, quaternion and residual of each; else empty."""
    columns = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "rms_m")
    heads = [f"{motion.name}_{column}" for motion in motions for column in columns]
    yield (",".join(["frame", "time_s", *heads]) + "\r\n").encode("ascii")
    frames = range(timebase.num_frames)
    poses = [np.column_stack([m.place_m, m.quat_xyzw, m.rms_m]) for m in motions]
    for rows in frame_blocks(len(frames)):
        values = [unknown_outside(v, m.frames, frames[rows]) for v, m in zip(poses, motions, strict=True)]
        for number, line in zip(frames[rows], fixed(np.concatenate(values, axis=1), 6, ","), strict=True):
            yield f"{number},{timebase.time_s(number):.6f},{line}\r\n".replace("nan", "").encode("ascii")


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the joints from a file of ``encode``, block by block; NaN where empty."""
    with path.open(encoding="ascii") as file:
        file.readline()
        for values in read_rows(file, ","):
            yield values[:, 2:].reshape(len(values), -1, 3)


WRITER = Writer(
    lambda person: encode(person.track, person.joints, person.timebase, person.frames),
    lambda path, _: read_xyz_m(path),
    joint_positions,
)
