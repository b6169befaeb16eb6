"""Euler angles of joints: triples that are continuous in time, and rotations half-way between two frames."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float

ORDERS = tuple("".join(axes) for axes in permutations("XYZ"))
"""All orders of three different axes."""

# Gimbal lock: cosine of the middle angle below which the other two rotations have the same axis.
_GIMBAL_LOCK = 1e-6


def euler_deg(
    rotations: Float[np.ndarray, "frames joints 3 3"], orders: Sequence[str], before_deg: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Angles of intrinsic rotations about three different axes: R = R1(a) R2(b) R3(c).

    Angles are continuous if the rotations are: of all triples for the same rotation, each frame has the triple closest
    to the previous frame, by the sum of the three steps as in Blender. So angles may leave [-180, 180]. In gimbal lock
    the last angle is kept, and the first angle is computed from it. ``orders`` has the axes of each joint, such as
    ``ZXY``; ``before_deg`` are the angles of the frame before the first frame. Angles are in degrees.
    """
    rename, sign = _renames(orders)
    axes = rename.argmax(-1)

    def entry(row: int, column: int) -> Float[np.ndarray, "frames joints"]:
        # Adding zero turns -0.0 into 0.0.
        return np.asarray(rotations[:, np.arange(len(axes)), axes[:, row], axes[:, column]] + 0.0)

    level, upright = entry(0, 1), entry(1, 1)
    cosine = np.hypot(level, upright)
    triples = _both(np.arctan2(-level, upright), np.arctan2(entry(2, 1), cosine), np.arctan2(-entry(2, 0), entry(2, 2)))
    before = sign * np.radians(before_deg)
    angles = _nearest(triples, before)
    is_locked = cosine < _GIMBAL_LOCK
    if is_locked.any():
        some = np.flatnonzero(is_locked.any(0))
        renamed = rename[some] @ rotations[:, some] @ rename[some].swapaxes(-1, -2)
        angles[:, some] = _nearest_through_locks(triples[:, :, some], renamed, is_locked[:, some], before[some])
    return sign * np.degrees(angles)


def _nearest(
    triples: Float[np.ndarray, "2 frames joints 3"], before: Float[np.ndarray, "joints 3"]
) -> Float[np.ndarray, "frames joints 3"]:
    """Triple of each frame that is closest to the triple of the frame before, up to full turns; all frames at once."""
    num_frames = triples.shape[1]
    if num_frames == 0:
        return triples[0]
    by_axis = np.ascontiguousarray(np.moveaxis(triples, -1, 0))
    first_second = [_is_second_nearer(by_axis[:, :, :1], before.T[:, None])]
    # Frames in which the second triple follows, for each triple of the frame before.
    after_first, after_second = (
        _is_second_nearer(by_axis[:, :, 1:], earlier) for earlier in (by_axis[:, 0, :-1], by_axis[:, 1, :-1])
    )
    # A frame whose choice does not depend on the one before starts again; others keep it or exchange it.
    begins = np.concatenate([np.ones_like(first_second[0]), after_first == after_second])
    chosen = np.concatenate([*first_second, after_first])
    exchanged = np.cumsum(chosen & ~begins, axis=0, dtype=np.int32)
    start = np.maximum.accumulate(np.where(begins, np.arange(num_frames)[:, None], 0), axis=0)
    odd = (exchanged - np.take_along_axis(exchanged, start, 0)) % 2 == 1
    is_second = np.take_along_axis(chosen, start, 0) ^ odd
    angles = np.where(is_second[..., None], triples[1], triples[0])
    steps = np.concatenate([before[None], angles[:-1]]) - angles
    return angles + 2 * np.pi * np.cumsum(np.round(steps / (2 * np.pi)), axis=0)


def _is_second_nearer(
    triples: Float[np.ndarray, "3 2 frames joints"], earlier: Float[np.ndarray, "3 #frames joints"]
) -> Bool[np.ndarray, "frames joints"]:
    """True where the second of two triples is nearer to an earlier one, up to full turns."""
    off = np.zeros(triples.shape[1:])
    for ends, start in zip(triples, earlier, strict=True):
        step = ends - start
        step -= 2 * np.pi * np.round(step / (2 * np.pi))
        off += np.abs(step)
    return np.asarray(off[1] < off[0])


def _nearest_through_locks(
    triples: Float[np.ndarray, "2 frames joints 3"],
    rotations: Float[np.ndarray, "frames joints 3 3"],
    is_locked: Bool[np.ndarray, "frames joints"],
    previous: Float[np.ndarray, "joints 3"],
) -> Float[np.ndarray, "frames joints 3"]:
    """Same of joints that are in gimbal lock in some frame, one frame after the other."""
    angles = np.empty(triples.shape[1:])
    for frame, locked in enumerate(is_locked):
        options = triples[:, frame]
        if locked.any():
            kept = previous[locked, 2]
            first, last = rotations[frame, locked, :, 0], rotations[frame, locked, :, 2]
            before_y = first * np.cos(kept)[:, None] + last * np.sin(kept)[:, None]
            options[:, locked, 0] = np.arctan2(before_y[:, 1], before_y[:, 0])
            options[:, locked, 2] = kept
        options = options + 2 * np.pi * np.round((previous - options) / (2 * np.pi))
        first_off, second_off = np.abs(options - previous).sum(-1)
        previous = np.where((second_off < first_off)[:, None], options[1], options[0])
        angles[frame] = previous
    return angles


def turned(angles_deg: Float[np.ndarray, "*batch 3"], order: str) -> Float[np.ndarray, "*batch 3 3"]:
    """Matrices of intrinsic rotations by angles in degrees about the axes of ``order``, such as ``ZXY``."""
    angles = np.radians(np.moveaxis(angles_deg, -1, 0))
    matrices = np.broadcast_to(np.eye(3).reshape(3, 3, *[1] * (angles.ndim - 1)), (3, 3, *angles.shape[1:])).copy()
    for axis, cosine, sine in zip(order, np.cos(angles), np.sin(angles), strict=True):
        place = "XYZ".index(axis)
        first, second = matrices[:, (place + 1) % 3], matrices[:, (place + 2) % 3]
        after = cosine * first + sine * second, cosine * second - sine * first
        matrices[:, (place + 1) % 3], matrices[:, (place + 2) % 3] = after
    return np.moveaxis(matrices, (0, 1), (-2, -1))


def halfway_by_angles(
    quat_xyzw: Float[np.ndarray, "frames joints 4"], orders: Sequence[str]
) -> Float[np.ndarray, "_ joints 4"]:
    """Rotation half-way between consecutive frames where each Euler angle is interpolated linearly.

    Rotations are quaternions (x, y, z, w); ``orders`` has the axes of each joint.
    """
    rename, sign = _renames(orders)
    x, y, z = np.moveaxis(sign * (rename @ quat_xyzw[..., :3, None])[..., 0], -1, 0)
    w = quat_xyzw[..., 3]
    level, upright = 2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z)
    triples = _both(
        np.arctan2(level, upright),
        np.arctan2(2.0 * (y * z + w * x), np.hypot(level, upright)),
        np.arctan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y)),
    )
    # Of a pair of frames, the second has the triple that is closer to the first. The way is the same from either triple
    # of the first frame.
    steps = triples[:, 1:] - triples[0, :-1]
    steps -= 2 * np.pi * np.round(steps / (2 * np.pi))
    first_off, second_off = np.abs(steps).sum(-1)
    half = 0.5 * triples[0, :-1] + 0.25 * np.where((second_off < first_off)[..., None], steps[1], steps[0])
    (cos_z, cos_x, cos_y), (sin_z, sin_x, sin_y) = np.moveaxis(np.cos(half), -1, 0), np.moveaxis(np.sin(half), -1, 0)
    vector = np.stack(
        [
            cos_z * sin_x * cos_y - sin_z * cos_x * sin_y,
            cos_z * cos_x * sin_y + sin_z * sin_x * cos_y,
            sin_z * cos_x * cos_y + cos_z * sin_x * sin_y,
        ],
        axis=-1,
    )
    scalar = cos_z * cos_x * cos_y - sin_z * sin_x * sin_y
    turned = sign * (rename.swapaxes(-1, -2) @ vector[..., None])[..., 0]
    return np.concatenate([turned, scalar[..., None]], axis=-1)


def halfway_on_arc(quat_xyzw: Float[np.ndarray, "frames joints 4"]) -> Float[np.ndarray, "_ joints 4"]:
    """Rotation half-way between consecutive frames on the shortest arc; quaternions (x, y, z, w)."""
    before, behind = quat_xyzw[:-1], quat_xyzw[1:]
    is_opposite = (before * behind).sum(-1, keepdims=True) < 0.0
    total = before + np.where(is_opposite, -behind, behind)
    middle: np.ndarray = total / np.linalg.norm(total, axis=-1, keepdims=True)
    return middle


def angle_rad(
    first_xyzw: Float[np.ndarray, "*batch 4"], second_xyzw: Float[np.ndarray, "*batch 4"]
) -> Float[np.ndarray, "*batch"]:
    """Angle of the rotation between two rotations."""
    apart = np.minimum(
        np.linalg.norm(first_xyzw - second_xyzw, axis=-1), np.linalg.norm(first_xyzw + second_xyzw, axis=-1)
    )
    angle: np.ndarray = 4.0 * np.arcsin(np.minimum(0.5 * apart, 1.0))
    return angle


def _renames(orders: Sequence[str]) -> tuple[Float[np.ndarray, "joints 3 3"], Float[np.ndarray, "joints 1"]]:
    """Matrix that renames each joint's axes so that its order is Z X Y, and the sign of angles: -1 if it reflects."""
    rename = np.zeros((len(orders), 3, 3))
    for matrix, order in zip(rename, orders, strict=True):
        matrix[[2, 0, 1], ["XYZ".index(axis) for axis in order]] = 1.0
    return rename, np.round(np.linalg.det(rename))[:, None]


def _both(
    z: Float[np.ndarray, "*batch"], x: Float[np.ndarray, "*batch"], y: Float[np.ndarray, "*batch"]
) -> Float[np.ndarray, "2 *batch 3"]:
    """Both triples, up to full turns, of the angles about Z, X and Y of the same rotation."""
    return np.stack([np.stack([z, x, y], -1), np.stack([z + np.pi, np.pi - x, y + np.pi], -1)])
