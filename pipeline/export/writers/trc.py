"""TRC files for OpenSim: positions of a person's joints as markers, in metres, Y up.

x, y, z are the world's x, z, -y, as in BVH. A joint that is unknown in a frame is ``nan``, because some readers skip
empty cells; so are all joints in frames before and after the track. Times are on the session's clock. Numbers are
rounded to 0.01 mm and 1 us.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.export.presets import Y_UP_FROM_WORLD
from pipeline.export.timelines import fixed, frame_blocks, read_rows, unknown_outside
from pipeline.export.writers.registry import Writer, joint_positions

_HEAD_LINES = 6


def encode(
    track: Track3D, joints: JointSet, timebase: Timebase, file_name: str, frames: range | None = None
) -> Iterator[bytes]:
    """Write a track's positions as TRC, piece by piece.

    ``track``: world positions (frames, joints, 3) in metres, Z up; NaN where a joint is unknown, which is ``nan`` in
    the file. ``file_name``: name of the file, part of the header. ``frames``: output frames of the file; ``None``: the
    track's frames. Joints are unknown outside the track's frames.

    >>> from pipeline.core.joints import COCO_17
    >>> known, zeros = np.zeros((2, 17, 3)), np.zeros((2, 17))
    >>> track = Track3D(1, 0, known, zeros, zeros.astype(np.int8), zeros, zeros.astype(int))
    >>> pieces = encode(track, COCO_17, Timebase(0.0, 30.0, 2), "person-1.trc")
    >>> b"".join(pieces).decode().splitlines()[2].split()
    ['30.', '30.', '2', '17', 'm', '30.', '1', '2']
    """
    frames = track.frames if frames is None else frames
    num_frames, num_joints = len(frames), track.xyz_m.shape[1]
    yield head(file_name, joints.names, timebase.frame_rate_hz, num_frames)
    for rows in frame_blocks(num_frames):
        xyz_m = unknown_outside(track.xyz_m, track.frames, frames[rows])
        places = fixed((xyz_m @ Y_UP_FROM_WORLD.T).reshape(-1, 3 * num_joints), 5, "\t")
        lines = (
            f"{number + 1}\t{timebase.time_s(frames[number]):.6f}\t{place}\n"
            for number, place in enumerate(places, rows.start)
        )
        yield "".join(lines).encode("ascii")


def head(file_name: str, names: Sequence[str], frame_rate_hz: float, num_frames: int) -> bytes:
    """Write the head of a file with the names of its markers."""
    rate = np.format_float_positional(frame_rate_hz)
    lines = (
        f"PathFileType\t4\t(X/Y/Z)\t{file_name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{num_frames}\t{len(names)}\tm\t{rate}\t1\t{num_frames}",
        "Frame#\tTime\t" + "\t".join(f"{name}\t\t" for name in names),
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        "",
    )
    return "".join(f"{line}\n" for line in lines).encode("utf-8")


def read_xyz_m(path: Path) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the joints from a file of ``encode``, block by block; NaN where unknown."""
    with path.open(encoding="utf-8") as file:
        for _ in range(_HEAD_LINES):
            file.readline()
        for values in read_rows(file, "\t"):
            yield values[:, 2:].reshape(len(values), -1, 3) @ Y_UP_FROM_WORLD


WRITER = Writer(
    lambda person: encode(person.track, person.joints, person.timebase, person.file_name, person.frames),
    lambda path, _: read_xyz_m(path),
    joint_positions,
)
