"""Limbs of two bones that reach places: bent about their hinges, turned as little as possible; over all frames."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.motion.skeleton.rotations import times

# Share of its length to which a limb is stretched.
REACH = 0.9999
_TINY = 1e-9


class BentLimb(NamedTuple):
    """Rotations of the two bones of a limb from the T-pose, and the place of its end."""

    upper: Float[np.ndarray, "frames 3 3"]
    lower: Float[np.ndarray, "frames 3 3"]
    end: Float[np.ndarray, "frames 3"]


def reach(
    start: Float[np.ndarray, "frames 3"],
    limb: BentLimb,
    along: Float[np.ndarray, " 3"],
    hinge: Float[np.ndarray, " 3"],
    lengths: tuple[float, float],
    place: Float[np.ndarray, "frames 3"],
    is_firm: bool,
) -> BentLimb:
    """Bend a limb and turn it so that its end is at a place, or as near as it reaches.

    The limb bends about its hinge, then turns as a whole by the smallest rotation. A limb that is there already stays
    as it is.

    Parameters
    ----------
    start
        Place of its first joint.
    along, hinge
        Direction of both bones in the T-pose, and axis about which a positive rotation bends the second one.
    lengths
        Lengths of both bones.
    is_firm
        Whether a limb that is bent beyond straight bends the other way if it does not reach the place else.
    """
    first, second = lengths
    upper, lower, axis = times(limb.upper, along), times(limb.lower, along), times(limb.upper, hinge)
    way = place - start
    distance = np.clip(np.linalg.norm(way, axis=-1), abs(first - second) * (2.0 - REACH), (first + second) * REACH)
    # Angle between both bones; what of the second one is not in the plane of the hinge is kept.
    cosine = (distance**2 - first**2 - second**2) / (2.0 * first * second)
    aside = np.einsum("fi,fi->f", lower, axis)
    in_plane = np.maximum(np.sqrt(np.maximum(1.0 - aside**2, 0.0)), _TINY)
    bent = np.arctan2(np.einsum("fi,fi->f", lower, np.cross(axis, upper)), np.einsum("fi,fi->f", lower, upper))
    wanted = np.arccos(np.clip(cosine / in_plane, -1.0, 1.0))
    if is_firm:
        # A limb that was bent beyond straight stays so, unless it has to bend much farther than it did.
        beyond = np.clip(-bent / np.maximum(wanted, _TINY) * 3.0 - 1.0, 0.0, 1.0)
        wanted = wanted * (1.0 - 2.0 * beyond * beyond * (3.0 - 2.0 * beyond))
    else:
        wanted = np.where(bent < 0.0, np.maximum(-wanted, bent), wanted)
    turned = Rotation.from_rotvec(axis * (wanted - bent)[:, None]).as_matrix()
    lower = np.einsum("fij,fj->fi", turned, lower)
    reached = first * upper + second * lower
    swung = swing_between(reached, way)
    end = start + np.einsum("fij,fj->fi", swung, reached)
    return BentLimb(swung @ limb.upper, swung @ turned @ limb.lower, end)


def swing_between(
    start: Float[np.ndarray, "frames 3"], end: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 3 3"]:
    """Smallest rotations from directions to other ones; the identity where one of them has no length."""
    axis = np.cross(start, end)
    sine, cosine = np.linalg.norm(axis, axis=-1), np.einsum("fi,fi->f", start, end)
    angle = np.arctan2(sine, cosine)
    # The axis of a half turn is any one at right angles.
    aside = np.cross(start, np.eye(3)[np.abs(start).argmin(-1)])
    is_flat = sine <= _TINY * np.linalg.norm(start, axis=-1) * np.linalg.norm(end, axis=-1)
    axis = np.where(is_flat[:, None], aside, axis)
    length = np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), _TINY)
    return Rotation.from_rotvec(axis / length * angle[:, None]).as_matrix()


def twist_rad(turn: Float[np.ndarray, "frames 3 3"], axis: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " frames"]:
    """Angles of rotations about an axis, their swing left out."""
    quat = Rotation.from_matrix(turn, assume_valid=True).as_quat()
    angle: np.ndarray = 2.0 * np.arctan2(quat[:, :3] @ axis, quat[:, 3])
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def between(
    start: Float[np.ndarray, "frames 3 3"],
    end: Float[np.ndarray, "frames 3 3"],
    share: float | Float[np.ndarray, " frames"],
) -> Float[np.ndarray, "frames 3 3"]:
    """Rotations on the shortest way from some to others; share 0 is the start."""
    way = Rotation.from_matrix(start.swapaxes(1, 2) @ end, assume_valid=True).as_rotvec()
    return start @ Rotation.from_rotvec(way * np.reshape(share, (-1, 1))).as_matrix()
