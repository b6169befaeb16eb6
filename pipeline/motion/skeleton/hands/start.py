"""Frames in which a hand was seen well, and the pose of the hand from which its fit starts."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_opening, distance_transform_edt
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side
from pipeline.motion.skeleton.hands.anatomy import NUM_HINGES, bend_angles_rad, fingers_of, natural_rad
from pipeline.motion.skeleton.rotations import align, filled

# Fewest located joints of all fingers, and of the four at the palm, in a hand that was seen well.
_FEWEST_JOINTS, _FEWEST_KNUCKLES = 8, 3
# Shortest time in which a hand is seen, and distances of the knuckles from the wrist.
_SHORTEST_S = 0.1
_KNUCKLES_M = (0.03, 0.20)
# Time from the last frame in which a hand was seen until it rests.
_REST_AFTER_S = 0.5
# Landmarks of the knuckles of index, middle, ring and little finger; landmark 0 is the wrist.
_KNUCKLES = (5, 9, 13, 17)


@dataclass(frozen=True, slots=True, eq=False)
class HandPose:
    """Pose of a hand in each frame."""

    forearm_from_hand: Rotation  # Rotation of the hand to the forearm
    angle_rad: Float[np.ndarray, "frames hinges"]  # Angles of the hinges of all fingers


def seen_well(
    wrist_m: Float[np.ndarray, "frames 3"],
    fingers_m: Float[np.ndarray, "frames joints 3"],
    measured: Bool[np.ndarray, "frames joints"],
    frame_rate_hz: float,
) -> Bool[np.ndarray, " frames"]:
    """Frames in which two cameras or more saw enough of a hand.

    ``fingers_m`` are located joints, ``measured`` where two cameras saw them.
    """
    knuckles = np.array(_KNUCKLES) - 1
    enough = (measured.sum(1) >= _FEWEST_JOINTS) & (measured[:, knuckles].sum(1) >= _FEWEST_KNUCKLES)
    reach_m = np.linalg.norm(fingers_m[:, knuckles] - wrist_m[:, None], axis=-1)
    reach_m = np.where(measured[:, knuckles] & enough[:, None], reach_m, np.nan)
    middle_m = np.full(len(reach_m), np.inf)
    known = np.isfinite(reach_m).any(1)
    middle_m[known] = np.nanmedian(reach_m[known], axis=1)
    near = (middle_m >= _KNUCKLES_M[0]) & (middle_m <= _KNUCKLES_M[1])
    shortest = min(max(1, round(_SHORTEST_S * frame_rate_hz)), len(near))
    return np.asarray(binary_opening(near, np.ones(shortest)))


def start_of(
    side: Side,
    world_from_forearm: Rotation,
    points_m: Float[np.ndarray, "frames landmarks 3"],
    is_seen: Bool[np.ndarray, " frames"],
    bone_length_m: Float[np.ndarray, " joints"],
    frame_rate_hz: float,
) -> HandPose:
    """Pose of a hand by its located landmarks, each frame by itself.

    Unknown values pass evenly between known frames. Far from frames in which the hand was seen, it is in the natural
    pose; it passes to it smoothly. Landmarks are world positions of the wrist and of all joints of the fingers, NaN
    where unknown; ``is_seen`` are the frames in which the hand was seen well.
    """
    share = _share_at_rest(is_seen, frame_rate_hz)
    if not is_seen.any():
        rest = Rotation.identity(len(is_seen))
        return HandPose(rest, np.tile(natural_rad(), (len(is_seen), 1)))
    fingers = [finger for name, finger in fingers_of(side).items() if name != "thumb"]
    palm_m = np.array([bone_length_m[finger.joints[0]] * finger.directions[0] for finger in fingers])
    from_wrist_m = points_m[:, _KNUCKLES] - points_m[:, :1]
    world_from_hand = align(np.broadcast_to(palm_m, from_wrist_m.shape), from_wrist_m)
    turned = filled(world_from_forearm.inv() * world_from_hand, is_seen)
    in_hand_m = np.einsum("fba,flb->fla", world_from_hand.as_matrix(), points_m - points_m[:, :1])
    angle_rad = bend_angles_rad(side, in_hand_m)
    natural = natural_rad()
    frames = np.arange(len(is_seen))
    for hinge in range(NUM_HINGES):
        known = np.flatnonzero(is_seen & np.isfinite(angle_rad[:, hinge]))
        angle_rad[:, hinge] = (
            np.interp(frames, known, angle_rad[known, hinge]) if len(known) else np.full(len(frames), natural[hinge])
        )
    rested = Rotation.from_rotvec(turned.as_rotvec() * (1.0 - share)[:, None])
    return HandPose(rested, angle_rad + share[:, None] * (natural - angle_rad))


def _share_at_rest(is_seen: Bool[np.ndarray, " frames"], frame_rate_hz: float) -> Float[np.ndarray, " frames"]:
    """Share of the natural pose in each frame: 0 where the hand is seen, 1 half a second away."""
    if not is_seen.any():
        return np.ones(len(is_seen))
    along = np.clip(distance_transform_edt(~is_seen) / (_REST_AFTER_S * frame_rate_hz), 0.0, 1.0)
    return np.asarray(along * along * (3.0 - 2.0 * along))
