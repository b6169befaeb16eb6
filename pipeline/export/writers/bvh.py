"""BVH files: six channels at the hips, three rotations at every other joint.

A preset defines names, axes, unit, rest pose and order of rotations. Lengths are rounded to 0.01 mm and angles to
0.0001 degrees; the frame time has full precision. The file begins at the person's first frame.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.data.animation import SkeletonMotion
from pipeline.export.presets import Convention
from pipeline.export.writers.blocks import fixed, frame_blocks, read_rows
from pipeline.skeleton.model import INDEX, SKELETON, WHOLE_SKELETON, children_of, parents_of

# Gimbal lock: cosine of the middle angle below which the other two rotations have the same axis.
_GIMBAL_LOCK = 1e-6
_ANGLE_DECIMALS = 4


def euler_deg(
    rotations: Float[np.ndarray, "frames joints 3 3"], order: str, before_deg: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Angles of intrinsic rotations about three different axes: R = R1(a) R2(b) R3(c).

    Angles are continuous if the rotations are: of all triples for the same rotation, each frame has the triple closest
    to the previous frame. So angles may leave [-180, 180]. In gimbal lock the last angle is kept, and the first angle
    is computed from it. ``order`` has the axes, such as ``ZXY``; ``before_deg`` are the angles of the frame before the
    first frame. Angles are in degrees.
    """
    # Rename the axes so that the order is Z X Y. If the renaming is a reflection, all signs change.
    rename = np.zeros((3, 3))
    rename[[2, 0, 1], ["XYZ".index(axis) for axis in order]] = 1.0
    rotations = rename @ rotations @ rename.T
    sign = round(float(np.linalg.det(rename)))
    cosine = np.hypot(rotations[..., 0, 1], rotations[..., 1, 1])
    z = np.arctan2(-rotations[..., 0, 1], rotations[..., 1, 1])
    x = np.arctan2(rotations[..., 2, 1], cosine)
    y = np.arctan2(-rotations[..., 2, 0], rotations[..., 2, 2])
    triples = np.stack([np.stack([z, x, y], -1), np.stack([z + np.pi, np.pi - x, y + np.pi], -1)])

    angles = np.empty((*z.shape, 3))
    previous = sign * np.radians(before_deg)
    is_locked = cosine < _GIMBAL_LOCK
    has_locked = is_locked.any(-1).tolist()
    for frame in range(len(z)):
        options = triples[:, frame]
        if has_locked[frame]:
            locked = is_locked[frame]
            kept = previous[locked, 2]
            first, last = rotations[frame, locked, :, 0], rotations[frame, locked, :, 2]
            before_y = first * np.cos(kept)[:, None] + last * np.sin(kept)[:, None]
            options[:, locked, 0] = np.arctan2(before_y[:, 1], before_y[:, 0])
            options[:, locked, 2] = kept
        options = options + 2 * np.pi * np.round((previous - options) / (2 * np.pi))
        first_off, second_off = ((options - previous) ** 2).sum(-1)
        previous = np.where((second_off < first_off)[:, None], options[1], options[0])
        angles[frame] = previous
    return sign * np.degrees(angles)


def _decimals(convention: Convention) -> int:
    return 5 - round(np.log10(convention.units_per_m))


def _depth_first(name: str, children: Mapping[str, tuple[str, ...]]) -> Iterator[str]:
    """Names of the joints with channels, in depth-first order."""
    if children[name]:
        yield name
        for child in children[name]:
            yield from _depth_first(child, children)


_ROOT = SKELETON[0].name


def encode(motion: SkeletonMotion, convention: Convention) -> Iterator[bytes]:
    """Write a motion as BVH, piece by piece.

    Equal motions give equal bytes.
    """
    yield "".join(f"{line}\n" for line in _head(motion, convention)).encode("utf-8")
    decimals = _decimals(convention)
    order = [INDEX[name] for name in _depth_first(_ROOT, children_of(len(motion.bone_length_m)))]
    angles_deg = np.zeros((1, len(order), 3))
    for rows in frame_blocks(len(motion.root_m)):
        quat = convention.parent_from_joint(motion.parent_from_joint[rows])[:, order]
        rotations = Rotation.from_quat(quat.reshape(-1, 4)).as_matrix().reshape(*quat.shape[:2], 3, 3)
        angles_deg = euler_deg(rotations, convention.rotation_order, angles_deg[-1])
        positions = fixed(convention.file_from_xyz_m(motion.root_m[rows]), decimals)
        angles = fixed(angles_deg.reshape(len(quat), -1), _ANGLE_DECIMALS)
        yield "".join(f"{place} {turn}\n" for place, turn in zip(positions, angles, strict=True)).encode("ascii")


def _head(motion: SkeletonMotion, convention: Convention) -> Iterator[str]:
    offsets = fixed(convention.rest_offsets(motion.bone_length_m), _decimals(convention))
    yield "HIERARCHY"
    yield from _hierarchy(_ROOT, children_of(len(offsets)), offsets, convention, 0)
    yield "MOTION"
    yield f"Frames: {len(motion.root_m)}"
    yield f"Frame Time: {np.format_float_positional(1.0 / motion.frame_rate_hz)}"


def _hierarchy(
    joint: str, children_by_name: Mapping[str, tuple[str, ...]], offsets: list[str], convention: Convention, depth: int
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
        rotations = " ".join(f"{axis}rotation" for axis in convention.rotation_order)
        yield f"{indent}\tCHANNELS {3 if depth else 6} {positions}{rotations}"
    for child in children:
        yield from _hierarchy(child, children_by_name, offsets, convention, depth + 1)
    yield f"{indent}}}"


def read_xyz_m(path: Path, convention: Convention) -> Iterator[Float[np.ndarray, "_ joints 3"]]:
    """Read world positions (metres) of the skeleton's joints from a file of ``encode``, block by block."""
    offset_by_joint: dict[int, list[float]] = {}
    index_of = {convention.name(name): index for name, index in INDEX.items()}
    above: list[int] = []
    order: list[int] = []
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
                case ["}"]:
                    above.pop()
                case ["Frame", "Time:", _]:
                    break
        offsets = np.array([offset_by_joint[index] for index in range(len(offset_by_joint))])
        for values in read_rows(file, " "):
            yield convention.xyz_m_from_file(_positions(values, offsets, order, convention.rotation_order))


def _positions(
    values: Float[np.ndarray, "frames channels"], offsets: Float[np.ndarray, "joints 3"], order: list[int], axes: str
) -> Float[np.ndarray, "frames joints 3"]:
    positions = np.empty((len(values), len(offsets), 3))
    file_from_joint: dict[int, Rotation] = {}
    for index, parent in enumerate(parents_of(len(offsets))):
        if index == 0:
            positions[:, index], file_from_parent = values[:, :3], Rotation.identity()
        else:
            file_from_parent = file_from_joint[parent]
            positions[:, index] = positions[:, parent] + file_from_parent.apply(offsets[index])
        if index in order:
            column = 3 + 3 * order.index(index)
            turn = Rotation.from_euler(axes, values[:, column : column + 3], degrees=True)
            file_from_joint[index] = file_from_parent * turn
    return positions
