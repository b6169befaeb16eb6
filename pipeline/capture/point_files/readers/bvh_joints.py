"""Reader of BVH files: places of the joints by forward kinematics; the unit is told by the person, Y up."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.capture.keypoint_files.people import KeypointsError, check_frames
from pipeline.capture.point_files.point_reader import MAX_NUMBERS, PointTable, point_reader

_MAX_JOINTS = 1000


@point_reader("BVH", ".bvh")
def read_bvh(path: Path) -> PointTable:
    """Read a file; the end of a chain has the name of its last joint and ``End``."""
    hierarchy, _, motion = path.read_text("utf-8-sig").partition("MOTION")
    names, parents, offsets, channels = _joints(hierarchy.split())
    num_channels = sum(map(len, channels))
    head, _, numbers = motion.partition("Frame Time:")
    seconds, _, numbers = numbers.strip().partition("\n")
    values = np.array(numbers.split(), float)
    if not num_channels or len(values) % num_channels or not len(values) or "Frames:" not in head:
        raise KeypointsError("The numbers of the frames do not fit the joints' channels.")
    values = values.reshape(-1, num_channels)
    check_frames(len(values))
    if len(values) * len(names) > MAX_NUMBERS:
        raise KeypointsError(f"The file has more than {MAX_NUMBERS:,} numbers; cut it into several.")
    places = np.zeros((len(values), len(names), 3))
    turns: list[Rotation] = []
    column = 0
    for joint, own in enumerate(channels):
        moved = np.tile(offsets[joint], (len(values), 1))
        part = values[:, column : column + len(own)]
        column += len(own)
        for axis, name in enumerate("XYZ"):
            if f"{name}position" in own:
                moved[:, axis] = part[:, own.index(f"{name}position")]
        axes = "".join(channel[0] for channel in own if channel.endswith("rotation"))
        angles = part[:, [channel.endswith("rotation") for channel in own]]
        turn = Rotation.from_euler(axes, angles, degrees=True) if axes else Rotation.identity(len(values))
        parent = parents[joint]
        places[:, joint] = moved if parent < 0 else places[:, parent] + turns[parent].apply(moved)
        turns.append(turn if parent < 0 else turns[parent] * turn)
    rate_hz, decimals = 1.0 / float(seconds), len(seconds.strip().partition(".")[2])
    is_whole = round(rate_hz) > 0 and round(1.0 / round(rate_hz), decimals) == float(seconds)
    return PointTable(tuple(names), places, round(rate_hz) if is_whole else rate_hz, None, "y")


def _joints(words: list[str]) -> tuple[list[str], list[int], list[list[float]], list[list[str]]]:
    """Names, parents, offsets and channels of the joints of a hierarchy."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[list[str]] = []
    chain: list[int] = []
    rest = iter(words)
    for word in rest:
        if word in {"ROOT", "JOINT", "End"}:
            name = next(rest)
            parents.append(chain[-1] if chain else -1)
            names.append(f"{names[chain[-1]]}End" if word == "End" else name)
            offsets.append([0.0] * 3)
            channels.append([])
        elif word == "{":
            chain.append(len(names) - 1)
        elif word == "}":
            chain.pop()
        elif word == "OFFSET":
            offsets[chain[-1]] = [float(next(rest)) for _ in range(3)]
        elif word == "CHANNELS":
            channels[chain[-1]] = [next(rest) for _ in range(min(int(next(rest)), 6))]
        if len(names) > _MAX_JOINTS:
            raise KeypointsError(f"The file has more than {_MAX_JOINTS} joints.")
    return names, parents, offsets, channels
