"""BVH files: Y up, centimetres, six channels at the hips, three rotations (Z X Y) at every other joint.

The rest pose is the T-pose of ``pipeline.skeleton.model``, here facing +Z with the left side to +X. Numbers are rounded
to 0.1 mm and 0.0001 degrees, the frame time has full precision. The file begins at the person's first frame.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.data import SkeletonMotion
from pipeline.export.axes import Y_UP_FROM_WORLD
from pipeline.skeleton.model import CHILDREN, INDEX, SKELETON, rest_offsets_m

_CM_PER_M = 100.0
# Cosine of the X angle below which Z and Y turn about the same axis, so that only their sum is known.
_GIMBAL_LOCK = 1e-6


def euler_zxy_deg(rotations: Float[np.ndarray, "frames joints 3 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Intrinsic Z, X, Y angles of rotation matrices: R = Rz(z) Rx(x) Ry(y).

    As continuous as the rotations are: of all triples that make the same rotation each frame takes the one closest to
    the frame before, so angles may leave [-180, 180]. In gimbal lock Y stays as it was, and Z takes up the rest.
    """
    cosine = np.hypot(rotations[..., 0, 1], rotations[..., 1, 1])
    z = np.arctan2(-rotations[..., 0, 1], rotations[..., 1, 1])
    x = np.arctan2(rotations[..., 2, 1], cosine)
    y = np.arctan2(-rotations[..., 2, 0], rotations[..., 2, 2])
    triples = np.stack([np.stack([z, x, y], -1), np.stack([z + np.pi, np.pi - x, y + np.pi], -1)])

    angles = np.empty((*z.shape, 3))
    previous = np.zeros((z.shape[1], 3))
    for frame in range(len(z)):
        options = triples[:, frame]
        locked = cosine[frame] < _GIMBAL_LOCK
        if locked.any():
            kept = previous[locked, 2]
            first, last = rotations[frame, locked, :, 0], rotations[frame, locked, :, 2]
            before_y = first * np.cos(kept)[:, None] + last * np.sin(kept)[:, None]
            options[:, locked, 0] = np.arctan2(before_y[:, 1], before_y[:, 0])
            options[:, locked, 2] = kept
        options = options + 2 * np.pi * np.round((previous - options) / (2 * np.pi))
        closest = ((options - previous) ** 2).sum(-1).argmin(0)
        previous = np.take_along_axis(options, closest[None, :, None], axis=0)[0]
        angles[frame] = previous
    return np.degrees(angles)


def _fixed(values: Float[np.ndarray, "rows columns"], decimals: int) -> list[list[str]]:
    """Decimal texts; adding zero turns -0.0 into 0.0."""
    return [[f"{value:.{decimals}f}" for value in row] for row in (np.round(values, decimals) + 0.0).tolist()]


def _hierarchy(name: str, offsets: list[list[str]], depth: int) -> Iterator[str]:
    """Lines of a joint and all below it."""
    indent = "\t" * depth
    children = CHILDREN[name]
    kind = "JOINT" if depth else "ROOT"
    yield f"{indent}{kind} {name}" if children else f"{indent}End Site"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {' '.join(offsets[INDEX[name]])}"
    if children:
        positions = "" if depth else "Xposition Yposition Zposition "
        num_channels = 3 if depth else 6
        yield f"{indent}\tCHANNELS {num_channels} {positions}Zrotation Xrotation Yrotation"
    for child in children:
        yield from _hierarchy(child, offsets, depth + 1)
    yield f"{indent}}}"


def _depth_first(name: str) -> Iterator[str]:
    """Names of the joints that have channels, in the order of their channels."""
    if CHILDREN[name]:
        yield name
        for child in CHILDREN[name]:
            yield from _depth_first(child)


def encode(motion: SkeletonMotion) -> bytes:
    """Write a motion as BVH.

    The same motion always gives the same bytes.
    """
    root = SKELETON[0].name
    offsets_cm = rest_offsets_m(motion.bone_length_m) @ Y_UP_FROM_WORLD.T * _CM_PER_M
    order = [INDEX[name] for name in _depth_first(root)]
    quat = motion.parent_from_joint[:, order]
    in_world = Rotation.from_quat(quat.reshape(-1, 4)).as_matrix().reshape(*quat.shape[:2], 3, 3)
    angles_deg = euler_zxy_deg(Y_UP_FROM_WORLD @ in_world @ Y_UP_FROM_WORLD.T)
    positions = _fixed(motion.root_m @ Y_UP_FROM_WORLD.T * _CM_PER_M, 2)
    angles = _fixed(angles_deg.reshape(len(quat), -1), 4)
    lines = [
        "HIERARCHY",
        *_hierarchy(root, _fixed(offsets_cm, 2), 0),
        "MOTION",
        f"Frames: {len(quat)}",
        f"Frame Time: {np.format_float_positional(1.0 / motion.frame_rate_hz)}",
        *(" ".join(position + angle) for position, angle in zip(positions, angles, strict=True)),
    ]
    return ("\n".join(lines) + "\n").encode("ascii")
