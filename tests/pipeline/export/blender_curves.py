"""Blender's importer of BVH (5.0.1) without Blender: positions of bones at frames and between them.

It follows ``io_anim_bvh/import_bvh.py``, and of Blender's C sources ``vec_roll_to_mat3_normalized`` and
``mat3_normalized_to_compatible_eulO``. ``tests/e2e/test_between_frames.py`` compares it with Blender itself.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(slots=True, eq=False)
class Bone:
    """Bone of a file; ``axes`` are in the order of its channels, ``values`` (frames, channels) the channels."""

    name: str
    parent: "Bone | None"
    offset: np.ndarray
    axes: str = ""
    values: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    ends: list[np.ndarray] = field(default_factory=list)  # Offsets of children, or of the end


def positions_in_blender(content: bytes, *, half_way: bool) -> dict[str, np.ndarray]:
    """Positions (frames, 3) of bones by name, in the file's axes and unit, and of the end of each bone without child.

    ``half_way`` is between consecutive frames, where Blender interpolates the angles of the bones.
    """
    positions: dict[str, np.ndarray] = {}
    rotations: dict[str, np.ndarray] = {}
    for bone in bones_of(content):
        from_parent = Rotation.from_euler(bone.axes, bone.values[:, -3:], degrees=True).as_matrix()
        root = bone.values[:, :3]
        if half_way:
            root, from_parent = (root[1:] + root[:-1]) / 2, half_way_of(bone, from_parent)
        if bone.parent is None:
            positions[bone.name], rotations[bone.name] = root, from_parent
        else:
            turn = rotations[bone.parent.name]
            positions[bone.name] = positions[bone.parent.name] + turn @ bone.offset
            rotations[bone.name] = turn @ from_parent
        if len(bone.ends) == 1:
            positions.setdefault(f"{bone.name}End", positions[bone.name] + rotations[bone.name] @ bone.ends[0])
    return positions


def bones_of(content: bytes) -> list[Bone]:
    """Bones of a file in its order."""
    head, motion = content.decode("ascii").split("MOTION\n")
    values = np.array([row.split() for row in motion.splitlines()[2:]], dtype=float)
    bones: list[Bone] = []
    above: list[Bone | None] = [None]
    column = 0
    for line in head.splitlines():
        match line.split():
            case [("ROOT" | "JOINT"), name]:
                bones.append(Bone(name, above[-1], np.zeros(3)))
                above.append(bones[-1])
            case ["End", "Site"]:
                above.append(None)
            case ["OFFSET", *numbers]:
                offset, bone = np.array(numbers, dtype=float), above[-1]
                parent = above[-2] if bone is None else bone.parent
                if bone is not None:
                    bone.offset = offset
                if parent is not None:
                    parent.ends.append(offset)
            case ["CHANNELS", count, *channels]:
                bones[-1].axes = "".join(channel[0] for channel in channels[-3:])
                bones[-1].values = values[:, column : column + int(count)]
                column += int(count)
            case ["}"]:
                above.pop()
    return bones


def half_way_of(bone: Bone, from_parent: np.ndarray) -> np.ndarray:
    """Rotations of a bone half-way between frames: the mean of the angles of each two frames."""
    rest = rest_of(np.mean(bone.ends, axis=0))
    before = np.zeros(3)
    angles = []
    for turn in rest.T @ from_parent @ rest:
        before = compatible_angles(turn, bone.axes, before)
        angles.append(before)
    middle = (np.array(angles)[1:] + np.array(angles)[:-1]) / 2
    order = ["XYZ".index(axis) for axis in bone.axes]
    # Blender turns about the first letter of a mode first.
    turns = Rotation.from_euler(bone.axes.lower(), middle[:, order]).as_matrix()
    return np.asarray(rest @ turns @ rest.T)


def rest_of(tail: np.ndarray) -> np.ndarray:
    """Axes of a bone at rest, in columns; its roll is 0."""
    x, y, z = tail / np.linalg.norm(tail)
    theta, level = 1.0 + y, x * x + z * z
    if theta <= 6.1e-3:
        if level <= 2.5e-4**2:
            return np.diag([-1.0, -1.0, 1.0])
        theta = 0.5 * level + 0.125 * level * level
    return np.array(
        [
            [1.0 - x * x / theta, x, -x * z / theta],
            [-x, y, -z],
            [-x * z / theta, z, 1.0 - z * z / theta],
        ]
    )


def compatible_angles(turn: np.ndarray, mode: str, before: np.ndarray) -> np.ndarray:
    """Angles about X, Y and Z of a mode, of the two triples the one with the smaller steps from earlier angles."""
    i, j, k = ("XYZ".index(axis) for axis in mode)
    parity = 1.0 if mode in {"XYZ", "YZX", "ZXY"} else -1.0
    cosine = np.hypot(turn[i, i], turn[j, i])
    triples = np.zeros((2, 3))
    for triple, sign in zip(triples, (1.0, -1.0), strict=True):
        triple[i] = np.arctan2(sign * turn[k, j], sign * turn[k, k])
        triple[j] = np.arctan2(-turn[k, i], sign * cosine)
        triple[k] = np.arctan2(sign * turn[j, i], sign * turn[i, i])
        if cosine <= 16 * np.finfo(np.float32).eps:
            triple[:] = 0.0
            triple[i], triple[j] = np.arctan2(-turn[j, k], turn[j, j]), np.arctan2(-turn[k, i], cosine)
    triples *= parity
    triples -= 2 * np.pi * np.round((triples - before) / (2 * np.pi))
    nearest: np.ndarray = triples[np.abs(triples - before).sum(1).argmin()]
    return nearest
