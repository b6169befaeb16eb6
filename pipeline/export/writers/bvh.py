"""BVH files: six channels at the hips, three rotations at every other joint.

A preset defines names, axes, unit and rest pose. ``rotation_orders`` chooses the orders of rotations by Blender's rule:
other programs whose reading of BVH is known interpolate quaternions. Lengths are rounded to 0.01 mm and angles to
0.0001 degrees; the frame time has full precision. Before and after the motion's own frames the nearest pose holds.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import SkeletonMotion
from pipeline.export.presets import PRESETS, Convention
from pipeline.export.timelines import fixed, held_blocks, read_rows
from pipeline.export.writers.euler import euler_deg
from pipeline.export.writers.registry import Writer
from pipeline.export.writers.rotation_orders import chained, matrices, rotation_orders
from pipeline.motion.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, children_of

_ANGLE_DECIMALS = 4


def _decimals(convention: Convention) -> int:
    return 5 - round(np.log10(convention.units_per_m))


def _depth_first(name: str, children: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    """Names of the joints with channels, in depth-first order."""
    if children[name]:
        yield name
        for child in children[name]:
            yield from _depth_first(child, children)


_ROOT = SKELETON[0].name


def encode(motion: SkeletonMotion, convention: Convention, frames: range | None = None) -> Iterator[bytes]:
    """Write a motion as BVH, piece by piece. Equal motions give equal bytes.

    Parameters
    ----------
    motion
        Bone lengths (joints,) and path of the root (frames, 3) in metres, rotations (frames, joints, 4) as quaternions
        (x, y, z, w); all are finite.
    convention
        Names, axes, unit and rest pose, such as ``PRESETS["default"]``.
    frames
        Output frames of the file; ``None``: the motion's frames. The nearest pose holds outside the motion's frames.

    Yields
    ------
        Bytes of the file, UTF-8.

    Examples
    --------
    >>> turns = np.tile([0.0, 0.0, 0.0, 1.0], (2, 24, 1))
    >>> motion = SkeletonMotion(1, "Anna", 0, 30.0, np.full(24, 0.3), np.zeros((2, 3)), turns, ())
    >>> b"".join(encode(motion, PRESETS["default"])).decode().splitlines()[:2]
    ['HIERARCHY', 'ROOT Hips']
    """
    own = motion.frames
    frames = own if frames is None else frames
    orders = rotation_orders(motion, convention, "Blender").axes
    yield "".join(f"{line}\n" for line in _head(motion, convention, orders, len(frames))).encode("utf-8")
    decimals = _decimals(convention)
    order = [INDEX[name] for name in _depth_first(_ROOT, children_of(len(motion.bone_length_m)))]
    angles_deg = np.zeros((1, len(order), 3))
    for block, num_times in held_blocks(own, frames):
        rows = slice(block.start - own.start, block.stop - own.start)
        quat = convention.parent_from_joint(motion.parent_from_joint[rows])[:, order]
        angles_deg = euler_deg(matrices(quat), [orders[index] for index in order], angles_deg[-1])
        positions = fixed(convention.file_from_xyz_m(motion.root_m[rows]), decimals)
        angles = fixed(angles_deg.reshape(len(quat), -1), _ANGLE_DECIMALS)
        lines = "".join(f"{place} {turn}\n" for place, turn in zip(positions, angles, strict=True))
        yield lines.encode("ascii") * num_times


def _head(motion: SkeletonMotion, convention: Convention, orders: Sequence[str], num_frames: int) -> Iterator[str]:
    offsets = fixed(convention.rest_offsets(motion.bone_length_m), _decimals(convention))
    yield "HIERARCHY"
    yield from _hierarchy(_ROOT, children_of(len(offsets)), offsets, convention, orders, 0)
    yield "MOTION"
    yield f"Frames: {num_frames}"
    yield f"Frame Time: {np.format_float_positional(1.0 / motion.frame_rate_hz)}"


def _hierarchy(
    joint: str,
    children_by_name: Mapping[str, tuple[str, ...]],
    offsets: list[str],
    convention: Convention,
    orders: Sequence[str],
    depth: int,
) -> Iterator[str]:
    """Lines of a joint and its descendants."""
    indent = "\t" * depth
    children = children_by_name[joint]
    kind = "JOINT" if depth else "ROOT"
    yield f"{indent}{kind} {convention.name(joint)}" if children else f"{indent}End Site"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {offsets[INDEX[joint]]}"
    if children:
        positions = "" if depth else "Xposition Yposition Zposition "
        rotations = " ".join(f"{axis}rotation" for axis in orders[INDEX[joint]])
        yield f"{indent}\tCHANNELS {3 if depth else 6} {positions}{rotations}"
    for child in children:
        yield from _hierarchy(child, children_by_name, offsets, convention, orders, depth + 1)
    yield f"{indent}}}"


def read_xyz_m(path: Path, convention: Convention) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the skeleton's joints from a file of ``encode``, (frames, joints, 3) a block."""
    offset_by_joint: dict[int, list[float]] = {}
    index_of = {convention.name(name): index for name, index in INDEX.items()}
    above: list[int] = []
    order: list[int] = []
    axes: list[str] = []
    with path.open(encoding="utf-8") as file:
        for line in file:
            match line.split():
                case [("ROOT" | "JOINT"), name]:
                    above.append(index_of[name])
                    order.append(above[-1])
                case ["End", "Site"]:
                    above.append(INDEX[f"{WHOLE_SKELETON[above[-1]].name}End"])
                case ["OFFSET", *offset]:
                    offset_by_joint[above[-1]] = [float(number) for number in offset]
                case ["CHANNELS", _, *channels]:
                    axes.append("".join(channel[0] for channel in channels[-3:]))
                case ["}"]:
                    above.pop()
                case ["Frame", "Time:", _]:
                    break
        offsets = np.array([offset_by_joint[index] for index in range(len(offset_by_joint))])
        for values in read_rows(file, " "):
            is_held = (values == values[0]).all()
            found = convention.xyz_m_from_file(_positions(values[:1] if is_held else values, offsets, order, axes))
            yield np.repeat(found, len(values) // len(found), axis=0)


def _positions(
    values: Float[np.ndarray, "frames channels"],
    offsets: Float[np.ndarray, "joints 3"],
    order: list[int],
    axes: list[str],
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
