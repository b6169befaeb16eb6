"""Frames in which a hand was seen well, and the pose of the hand from which its fit starts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_opening, distance_transform_edt
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.cameras import Camera
from pipeline.core.joints import JointSet
from pipeline.motion.skeleton.fitting.articulation import Articulation
from pipeline.motion.skeleton.fitting.gauss_newton import JointPoses, landmark_positions, refine
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.fitting.uncertainty import uncertainty_m
from pipeline.motion.skeleton.hands import anatomy
from pipeline.motion.skeleton.model import joint_pose
from pipeline.motion.skeleton.rotations import align, continuous_quat_xyzw, filled
from pipeline.motion.skeleton.time_series import Blend, windows

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


def start_pose(
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
        return HandPose(rest, np.tile(anatomy.natural_rad(), (len(is_seen), 1)))
    fingers = [finger for name, finger in anatomy.hand_fingers(side).items() if name != "thumb"]
    palm_m = np.array([bone_length_m[finger.joints[0]] * finger.directions[0] for finger in fingers])
    from_wrist_m = points_m[:, _KNUCKLES] - points_m[:, :1]
    world_from_hand = align(np.broadcast_to(palm_m, from_wrist_m.shape), from_wrist_m)
    turned = filled(world_from_forearm.inv() * world_from_hand, is_seen)
    in_hand_m = np.einsum("fba,flb->fla", world_from_hand.as_matrix(), points_m - points_m[:, :1])
    angle_rad = anatomy.bend_angles_rad(side, in_hand_m)
    natural = anatomy.natural_rad()
    frames = np.arange(len(is_seen))
    for hinge in range(anatomy.NUM_HINGES):
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


_NUM_STEPS = 4
# Scale of the function of Geman and McClure: a hand is small. And the noise of fingers across a ray, as a share of the
# noise that ``Rays`` assumes.
_SCALE_M = 0.04
_NOISE_SHARE = 0.6
# Standard deviations of positions as evidence: the body's wrist, the pose of the start where the hand was not seen, and
# smoothed positions.
_WRIST_M, _HELD_M, _PLACED_M = 0.007, 0.01, 0.01
# Usual acceleration of finger joints in lively movement.
_USUAL_M_S2 = 14.0


@dataclass(frozen=True, slots=True, eq=False)
class HandViews:
    """Located joints and observations of a hand."""

    fingers_m: Float[np.ndarray, "frames joints 3"]  # Located joints of the fingers, NaN where unknown
    # Observations of these joints in distorted pixels of the full image
    points_px: Float[np.ndarray, "frames cameras joints 2"]
    score: Float[np.ndarray, "frames cameras joints"]
    is_seen: Bool[np.ndarray, " frames"]  # Frames in which the hand was seen well


@dataclass(frozen=True, slots=True, eq=False)
class FittedHand:
    """Fit of a hand."""

    pose: HandPose  # Rotation of the wrist, and angles of all hinges
    # Standard deviation of the joints of the fingers in metres; ``None`` without rays, and where the hand was never
    # seen
    uncertainty_m: Float[np.ndarray, "frames joints"] | None


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """Rays of the fingers, if available, and target positions of landmarks with a weight (1 / variance)."""

    rays: Rays | None
    strength: Float[np.ndarray, "frames landmarks"]
    place_m: Float[np.ndarray, "frames landmarks 3"]

    def normal_equations(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> tuple[Float[np.ndarray, "frames landmarks 3 3"], Float[np.ndarray, "frames landmarks 3"]]:
        curvature = self.strength[..., None, None] * np.eye(3)
        pull = self.strength[..., None] * (self.place_m - landmark_m)
        if self.rays is not None:
            # The wrist comes before the fingers.
            for number in range(1, landmark_m.shape[1]):
                xyz_m = landmark_m[:, number]
                normal, right = self.rays.normal_equations(number - 1, xyz_m, _SCALE_M)
                curvature[:, number] += normal / _NOISE_SHARE**2
                pull[:, number] += (right - np.einsum("fab,fb->fa", normal, xyz_m)) / _NOISE_SHARE**2
        return curvature, pull

    def precision(
        self, landmark_m: Float[np.ndarray, "frames landmarks 3"]
    ) -> Float[np.ndarray, "frames landmarks 3 3"]:
        precision = self.strength[..., None, None] * np.eye(3)
        if self.rays is not None:
            for number in range(1, landmark_m.shape[1]):
                precision[:, number] += self.rays.precision(number - 1, landmark_m[:, number], _SCALE_M)
        return np.asarray(precision)


def fit_hand(
    side: Side,
    body: SkeletonMotion,
    bone_length_m: Float[np.ndarray, " whole"],
    views: HandViews,
    cameras: Sequence[Camera] | None,
) -> FittedHand:
    """Fit a hand on a fitted body.

    Lengths are of the bones of ``WHOLE_SKELETON``. The fit follows the rays of ``cameras``; ``None``: the located
    positions.
    """
    num_frames = len(body.root_m)
    skeleton = anatomy.articulate_hand(side, bone_length_m)
    quat, angle_rad = np.empty((num_frames, 4)), np.empty((num_frames, anatomy.NUM_HINGES))
    all_sigma_m = np.full((num_frames, len(skeleton.landmark)), np.nan)
    joined_quat, joined_rad, joined_m = Blend(quat), Blend(angle_rad), Blend(all_sigma_m)
    usual_m = np.full(len(skeleton.landmark), _USUAL_M_S2 / body.frame_rate_hz**2 if cameras else np.inf)
    for rows in windows(num_frames):
        wrist_m, forearm = wrist_pose(side, body, rows)
        points_m = np.concatenate([wrist_m[:, None], views.fingers_m[rows]], axis=1)
        start = start_pose(side, forearm, points_m, views.is_seen[rows], bone_length_m, body.frame_rate_hz)
        hand = _bodies(side, skeleton, wrist_m, forearm, start)
        found_m = np.full(points_m.shape[:2], np.nan)
        if views.is_seen[rows].any():
            evidence = _evidence(hand, skeleton, points_m, views, rows, cameras)
            refine(hand, skeleton, evidence, usual_m, body.frame_rate_hz, _NUM_STEPS)
            if cameras:
                sigma_m = uncertainty_m(hand, skeleton, evidence, body.frame_rate_hz)
                found_m = np.where(views.is_seen[rows, None], sigma_m, np.nan)
        turned = continuous_quat_xyzw(Rotation.from_matrix(hand.local[:, anatomy.WRIST_JOINT]))
        if rows.start and turned[0] @ quat[rows.start] < 0:
            turned = -turned
        joined_quat.add(rows, turned)
        joined_rad.add(rows, hand.angle_rad[:, -anatomy.NUM_HINGES :])
        joined_m.add(rows, found_m)
    pose = HandPose(Rotation.from_quat(quat), angle_rad)
    return FittedHand(pose, all_sigma_m[:, 1:] if cameras and views.is_seen.any() else None)


def wrist_pose(side: Side, body: SkeletonMotion, rows: slice) -> tuple[Float[np.ndarray, "rows 3"], Rotation]:
    """World positions of a wrist (metres) and orientations of its forearm in a range of frames."""
    shown = replace(body, root_m=body.root_m[rows], parent_from_joint=body.parent_from_joint[rows])
    wrist_m, _ = joint_pose(shown, f"{side.capitalize()}Hand")
    _, forearm = joint_pose(shown, f"{side.capitalize()}ForeArm")
    return wrist_m, forearm


def fingers_m(
    side: Side, body: SkeletonMotion, bone_length_m: Float[np.ndarray, " whole"], pose: HandPose, rows: slice
) -> Float[np.ndarray, "rows joints 3"]:
    """World positions of the joints of all fingers (metres), in the order of ``finger_joints``."""
    wrist_m, forearm = wrist_pose(side, body, rows)
    shown = HandPose(pose.forearm_from_hand[rows], pose.angle_rad[rows])
    skeleton = anatomy.articulate_hand(side, bone_length_m)
    return landmark_positions(_bodies(side, skeleton, wrist_m, forearm, shown), skeleton)[:, 1:]


def _bodies(
    side: Side, skeleton: Articulation, wrist_m: Float[np.ndarray, "frames 3"], forearm: Rotation, pose: HandPose
) -> JointPoses:
    """Joints of a hand on the body's wrist; hinges are clipped to their limits."""
    angle_rad = np.zeros((len(wrist_m), skeleton.num_freedoms))
    hinges = slice(-anatomy.NUM_HINGES, None)
    angle_rad[:, hinges] = np.clip(pose.angle_rad, skeleton.lowest_rad[hinges], skeleton.highest_rad[hinges])
    local = anatomy.local_rotations(side, forearm.as_matrix(), pose.forearm_from_hand.as_matrix(), angle_rad[:, hinges])
    return JointPoses(np.array(wrist_m), local, angle_rad)


def _evidence(
    start: JointPoses,
    skeleton: Articulation,
    points_m: Float[np.ndarray, "rows landmarks 3"],
    views: HandViews,
    rows: slice,
    cameras: Sequence[Camera] | None,
) -> _Evidence:
    """Evidence for the fit of a window."""
    start_m = landmark_positions(start, skeleton)
    is_seen = views.is_seen[rows, None]
    located = is_seen & np.isfinite(points_m).all(-1)
    strength = np.where(is_seen, 0.0, np.full(start_m.shape[:2], 1.0 / _HELD_M**2))
    place_m = start_m
    rays = None
    if cameras is None:
        strength = np.where(located, 1.0 / _PLACED_M**2, strength)
        place_m = np.where(located[..., None], points_m, start_m)
    else:
        score = np.where(is_seen[..., None], views.score[rows], 0.0)
        joints = JointSet(tuple(f"{number}" for number in range(score.shape[-1])), ())
        rays = Rays(cameras, views.points_px[rows], score, joints)
    strength[:, 0], place_m[:, 0] = 1.0 / _WRIST_M**2, points_m[:, 0]
    return _Evidence(rays, strength, place_m)
