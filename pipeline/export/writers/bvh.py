"""BVH files: six channels at the hips, three rotations at every other joint.

A preset defines names, axes, unit and rest pose. ``rotation_orders`` chooses the orders of rotations by Blender's rule:
other programs whose reading of BVH is known interpolate quaternions. Lengths are rounded to 0.01 mm and angles to
0.0001 degrees; the frame time has full precision. Before and after the motion's own frames the nearest pose holds.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import PRESETS, Convention
from pipeline.export.timelines import fixed, held_blocks, read_rows
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.registry import Writer
from pipeline.export.writers.rotation_orders import chained, matrices, rotation_orders
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, child_names

_ANGLE_DECIMALS = 4


def _decimals(convention: Convention) -> int:
    return 5 - round(np.log10(convention.units_per_m))


class BvhNode(NamedTuple):
    """Joint of a hierarchy, or end of a bone, whose children follow it in the file."""

    depth: int  # Number of joints above it
    name: str  # Empty for the end of a bone
    offset: str  # Place in its parent, three numbers
    axes: str  # Axes of its rotations, such as ``ZXY``


def encode_head(nodes: Sequence[BvhNode], num_frames: int, frame_rate_hz: float) -> bytes:
    """Write the hierarchy of a file, and the lines between it and the frames."""
    lines = ["HIERARCHY"]
    for node, following in zip_longest(nodes, nodes[1:]):
        indent = "\t" * node.depth
        lines += [f"{indent}{'JOINT' if node.depth else 'ROOT'} {node.name}" if node.name else f"{indent}End Site"]
        lines += [f"{indent}{{", f"{indent}\tOFFSET {node.offset}"]
        if node.name:
            place = "" if node.depth else "Xposition Yposition Zposition "
            rotations = " ".join(f"{axis}rotation" for axis in node.axes)
            lines.append(f"{indent}\tCHANNELS {3 if node.depth else 6} {place}{rotations}")
        last_closed = following.depth if following else 0
        lines += ["\t" * depth + "}" for depth in range(node.depth, last_closed - 1, -1)]
    lines += ["MOTION", f"Frames: {num_frames}", f"Frame Time: {np.format_float_positional(1.0 / frame_rate_hz)}"]
    return "".join(f"{line}\n" for line in lines).encode("utf-8")


class StoredNode(NamedTuple):
    """Joint of a file that was read, or end of a bone."""

    name: str  # Empty for the end of a bone
    parent: int  # Place of the parent among the nodes; -1 for the root
    offset: tuple[float, ...]
    axes: str  # Empty for the end of a bone


def read_head(file: TextIO) -> list[StoredNode]:
    """Read the nodes of a file in their order, up to the first frame."""
    nodes: list[StoredNode] = []
    above = [-1]
    for line in file:
        match line.split():
            case [("ROOT" | "JOINT" | "End") as kind, name]:
                nodes.append(StoredNode("" if kind == "End" else name, above[-1], (), ""))
                above.append(len(nodes) - 1)
            case ["OFFSET", *offset]:
                nodes[-1] = nodes[-1]._replace(offset=tuple(map(float, offset)))
            case ["CHANNELS", _, *channels]:
                nodes[-1] = nodes[-1]._replace(axes="".join(channel[0] for channel in channels[-3:]))
            case ["}"]:
                above.pop()
            case ["Frame", "Time:", _]:
                break
    return nodes


def _depth_first(name: str, children: Mapping[str, tuple[str, ...]], depth: int = 0) -> Iterator[tuple[int, str]]:
    """Number of joints above each joint, and its name, in depth-first order."""
    yield depth, name
    for child in children[name]:
        yield from _depth_first(child, children, depth + 1)


_ROOT = SKELETON[0].name


def encode(motion: SkeletonMotion, convention: Convention, frames: range | None = None) -> Iterator[bytes]:
    """Write a motion as BVH, piece by piece. Equal motions give equal bytes.

    ``motion``: bone lengths (joints,) and path of the root (frames, 3) in metres, rotations (frames, joints, 4) as
    quaternions (x, y, z, w); all are finite. ``convention``: names, axes, unit and rest pose, such as
    ``PRESETS["default"]``. ``frames``: output frames of the file; ``None``: the motion's frames. The nearest pose holds
    outside the motion's frames. Yields the bytes of the file, UTF-8.

    >>> turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 24, 1))
    >>> motion = SkeletonMotion(1, "Anna", 0, 30.0, np.full(24, 0.3), np.zeros((2, 3)), turns, ())
    >>> b"".join(encode(motion, PRESETS["default"])).decode().splitlines()[:2]
    ['HIERARCHY', 'ROOT Hips']
    """
    own = motion.frames
    frames = own if frames is None else frames
    orders, decimals = rotation_orders(motion, convention, "Blender").axes, _decimals(convention)
    children = child_names(len(motion.bone_length_m))
    offsets = fixed(convention.rest_offsets(motion.bone_length_m), decimals)
    joints = list(_depth_first(_ROOT, children))
    nodes = [
        BvhNode(depth, convention.name(name) if children[name] else "", offsets[INDEX[name]], orders[INDEX[name]])
        for depth, name in joints
    ]
    yield encode_head(nodes, len(frames), motion.frame_rate_hz)
    order = [INDEX[name] for _, name in joints if children[name]]
    angles_deg = np.zeros((1, len(order), 3))
    for block, num_times in held_blocks(own, frames):
        rows = slice(block.start - own.start, block.stop - own.start)
        quat = convention.parent_from_joint(motion.parent_from_joint[rows])[:, order]
        angles_deg = euler_deg(matrices(quat), [orders[index] for index in order], angles_deg[-1])
        positions = fixed(convention.file_from_xyz_m(motion.root_m[rows]), decimals)
        angles = fixed(angles_deg.reshape(len(quat), -1), _ANGLE_DECIMALS)
        lines = "".join(f"{place} {turn}\n" for place, turn in zip(positions, angles, strict=True))
        yield lines.encode("ascii") * num_times


def read_xyz_m(path: Path, convention: Convention) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the skeleton's joints from a file of ``encode``, (frames, joints, 3) a block."""
    index_of = {convention.name(name): index for name, index in INDEX.items()}
    with path.open(encoding="utf-8") as file:
        nodes = read_head(file)
        indices: list[int] = []
        for node in nodes:
            ending = f"{WHOLE_SKELETON[indices[node.parent]].name}End" if not node.name else ""
            indices.append(index_of[node.name] if node.name else INDEX[ending])
        offsets = np.empty((len(nodes), 3))
        offsets[indices] = [node.offset for node in nodes]
        order = [index for index, node in zip(indices, nodes, strict=True) if node.axes]
        axes = [node.axes for node in nodes if node.axes]
        for values in read_rows(file, " "):
            is_held = (values == values[0]).all()
            found = convention.xyz_m_from_file(_positions(values[:1] if is_held else values, offsets, order, axes))
            yield np.repeat(found, len(values) // len(found), axis=0)


def _positions(
    values: Float[np.ndarray, "frames channels"],
    offsets: Float[np.ndarray, "joints 3"],
    order: Sequence[int],
    axes: Sequence[str],
) -> Float[np.ndarray, "frames joints 3"]:
    """Positions in the file's axes and unit; ``order`` has the joints with channels, ``axes`` their rotations."""
    turns = np.broadcast_to(np.eye(3), (len(values), len(offsets), 3, 3)).copy()
    for place, (index, order_of_axes) in enumerate(zip(order, axes, strict=True)):
        angles_deg = values[:, 3 + 3 * place : 6 + 3 * place]
        turns[:, index] = Rotation.from_euler(order_of_axes, angles_deg, degrees=True).as_matrix()
    return chained(values[:, :3], offsets, turns)


WRITER = Writer(
    lambda person: encode(person.motion, PRESETS[person.preset], person.frames),
    lambda path, preset: read_xyz_m(path, PRESETS[preset]),
    between_frames=lambda person: rotation_orders(person.motion, PRESETS[person.preset], "Blender").between,
)
