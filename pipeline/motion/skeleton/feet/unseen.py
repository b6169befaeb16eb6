"""Feet without toes: orientation of feet of which only the ankle is known, by what the leg does."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Floor, FootContact, Side, SkeletonMotion
from pipeline.motion.skeleton.feet.floor import SIDES
from pipeline.motion.skeleton.feet.holding import stance_weight
from pipeline.motion.skeleton.feet.support import Support
from pipeline.motion.skeleton.model import INDEX, SKELETON, joint_pose
from pipeline.motion.skeleton.rotations import from_axes

_LEFT, _UP, _HORIZONTAL = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, 0.0])
# Limit on the bend of an ankle from the right angle with the shin.
_MAX_BEND_RAD = np.radians(45.0)
# Limit of feet whose insteps lie on the floor, and of toes that are pulled up.
_MAX_POINTED_RAD, _MAX_PULLED_RAD = np.radians(80.0), np.radians(35.0)
# Plantar flexion of relaxed ankles: of feet that hang, as in weightlessness (NASA-STD-3000: 111 degrees between shin
# and foot), and of feet above the hips.
_HANGING_RAD, _RAISED_RAD = np.radians(20.0), np.radians(10.0)
# Height of an ankle above the floor from which on its foot can't stand flat.
_OFF_FLOOR_M = 0.12
# Smoothing of the change from one state to the other, of the touch of the floor, and of the bend behind lying shins,
# which feet keep that are lifted from the floor for a moment.
_STATE_S, _TOUCH_S, _KEPT_S = 0.1, 0.05, 1.0
# Direction from the ankle to the end of the foot.
_TOES = next(joint.rest_direction for joint in SKELETON if joint.name == "LeftFootEnd")


def foot_without_toes(motion: SkeletonMotion, side: Side, support: Support, floor: Floor | None) -> Rotation:
    """Rotation from foot to shin where only the ankle is known.

    A standing foot is level on the floor and points in the direction that the shin faces; the foot of a person who
    kneels lies on its instep and points away from the knee. Other feet are at a right angle to the shin, relaxed if
    they hang or are above the hips, and not below the floor behind shins that lie. Orientations are blended before and
    after a stance.
    """
    share = stance_weight(motion.contacts, side, len(motion.root_m), motion.frame_rate_hz)
    _, world_from_shin = joint_pose(motion, f"{side.capitalize()}Leg")
    left = world_from_shin.apply(_LEFT) * _HORIZONTAL
    on_sole, is_known = from_axes(left, np.broadcast_to(_UP, left.shape))
    on_instep, _ = from_axes(left, np.broadcast_to(-_UP, left.shape))
    bend, limit_rad = (world_from_shin.inv() * on_sole).as_rotvec(), np.full(len(left), _MAX_BEND_RAD)
    # A foot does not bend up to a shin that faces the floor.
    pointed = (world_from_shin.inv() * on_instep).as_rotvec()
    lies = _by_contact((bend @ _LEFT < -_MAX_BEND_RAD) & (pointed @ _LEFT > 0.0), motion.contacts, side)
    bend[lies], limit_rad[lies] = pointed[lies], _MAX_POINTED_RAD
    bend *= np.minimum(1.0, limit_rad / np.maximum(np.linalg.norm(bend, axis=-1), 1e-9))[:, None]
    share = (share * is_known)[:, None]
    free_rad = _free_bend_rad(motion, side, world_from_shin, support, floor)[:, None]
    return Rotation.from_rotvec(share * bend + (1.0 - share) * free_rad * _LEFT)


def _free_bend_rad(
    motion: SkeletonMotion, side: Side, world_from_shin: Rotation, support: Support, floor: Floor | None
) -> Float[np.ndarray, " frames"]:
    """Plantar flexion of a foot that does not stand, in radians from the right angle with the shin."""
    foot, rate_hz = SIDES.index(side), motion.frame_rate_hz
    ankle_m, _ = joint_pose(motion, f"{side.capitalize()}Foot")
    height_m = np.full(len(ankle_m), np.inf) if floor is None else floor.height_m(ankle_m)
    hangs = support.hangs[:, foot] & (height_m > _OFF_FLOOR_M)
    is_raised = ankle_m[:, 2] > motion.root_m[:, 2]
    relaxed_rad = np.where(hangs, _HANGING_RAD, np.where(is_raised, _RAISED_RAD, 0.0))
    bend_rad = gaussian_filter1d(relaxed_rad, _STATE_S * rate_hz, mode="nearest")
    if floor is None:
        return bend_rad
    end_m = motion.bone_length_m[INDEX[f"{side.capitalize()}FootEnd"]] * np.array(_TOES)
    above_rad = _above_floor_rad(bend_rad, world_from_shin, end_m, height_m)
    is_lying = ~support.shin_stands[:, foot]
    share, sum_rad = (
        gaussian_filter1d(values, _KEPT_S * rate_hz, mode="nearest")
        for values in (is_lying + 0.0, is_lying * above_rad)
    )
    usual_rad = sum_rad / np.maximum(share, 1e-3)
    bend_rad = np.where(is_lying, np.maximum(above_rad, usual_rad), bend_rad)
    return np.asarray(gaussian_filter1d(bend_rad, _TOUCH_S * rate_hz, mode="nearest"))


def _above_floor_rad(
    bend_rad: Float[np.ndarray, " frames"],
    world_from_shin: Rotation,
    end_m: Float[np.ndarray, " 3"],
    height_m: Float[np.ndarray, " frames"],
) -> Float[np.ndarray, " frames"]:
    """Bends nearest to given ones with which the end of a foot is not below the floor.

    The end's height above the ankle is a cosine of the bend: ``reach_m cos(bend - highest)``. ``end_m`` is its offset
    from the ankle at no bend, and ``height_m`` the height of the ankle above the floor.
    """
    _, ahead, up = np.moveaxis(world_from_shin.as_matrix()[:, 2], -1, 0)
    level_m, turned_m = ahead * end_m[1] + up * end_m[2], up * end_m[1] - ahead * end_m[2]
    reach_m, highest_rad = np.hypot(level_m, turned_m), np.arctan2(turned_m, level_m)
    width_rad = np.arccos(np.clip(-height_m / np.maximum(reach_m, 1e-9), -1.0, 1.0))
    away_rad = np.angle(np.exp(1j * (bend_rad - highest_rad)))
    nearest_rad = bend_rad + np.clip(away_rad, -width_rad, width_rad) - away_rad
    return np.asarray(np.clip(nearest_rad, -_MAX_PULLED_RAD, _MAX_POINTED_RAD))


def _by_contact(
    lies: Bool[np.ndarray, " frames"], contacts: tuple[FootContact, ...], side: Side
) -> Bool[np.ndarray, " frames"]:
    """Majority of the frames of the nearest contact of a foot, so that the foot does not flip in a stance."""
    stances = [contact.rows for contact in contacts if contact.side == side]
    if not stances:
        return lies
    frames = np.arange(len(lies))
    starts, stops = np.array([(rows.start, rows.stop) for rows in stances]).T
    # Feet without toes stand as a whole: one stance follows the other.
    before = np.maximum(np.searchsorted(starts, frames, side="right") - 1, 0)
    after = np.minimum(before + 1, len(stances) - 1)
    is_nearer = starts[after] - frames < np.maximum(frames - stops[before] + 1, starts[before] - frames)
    return np.array([lies[rows].mean() > 0.5 for rows in stances])[np.where(is_nearer, after, before)]
