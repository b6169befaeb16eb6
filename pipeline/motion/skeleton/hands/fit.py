"""Fit of a hand over time, on the wrist of a body that was fitted before.

The unknowns are the rotation of the wrist and the hinges of ``anatomy``, and a shift of the hand as a whole, which is
then dropped: the wrist of the body stays where it is. The machinery is that of the body's fit
(``fitting.articulated``): rays of all views, accelerations of all joints, and priors for the natural pose. In frames in
which no two cameras saw the hand well, it is held in the pose of the start, which passes to the natural pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Side, SkeletonMotion
from pipeline.core.data.cameras import Camera
from pipeline.core.joints import JointSet
from pipeline.motion.skeleton.fitting.articulated import JointPoses, landmarks_of, refine
from pipeline.motion.skeleton.fitting.articulation import Articulation
from pipeline.motion.skeleton.fitting.rays import Rays
from pipeline.motion.skeleton.fitting.uncertainty import uncertainty_m
from pipeline.motion.skeleton.fitting.windows import Blend, windows
from pipeline.motion.skeleton.hands.anatomy import NUM_HINGES, WRIST_JOINT, articulate_hand, local_rotations
from pipeline.motion.skeleton.hands.start import HandPose, start_of
from pipeline.motion.skeleton.model import joint_pose
from pipeline.motion.skeleton.rotations import continuous_quat_xyzw

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
    skeleton = articulate_hand(side, bone_length_m)
    quat, angle_rad = np.empty((num_frames, 4)), np.empty((num_frames, NUM_HINGES))
    all_sigma_m = np.full((num_frames, len(skeleton.landmark)), np.nan)
    joined_quat, joined_rad, joined_m = Blend(quat), Blend(angle_rad), Blend(all_sigma_m)
    usual_m = np.full(len(skeleton.landmark), _USUAL_M_S2 / body.frame_rate_hz**2 if cameras else np.inf)
    for rows in windows(num_frames):
        wrist_m, forearm = wrist_of(side, body, rows)
        points_m = np.concatenate([wrist_m[:, None], views.fingers_m[rows]], axis=1)
        start = start_of(side, forearm, points_m, views.is_seen[rows], bone_length_m, body.frame_rate_hz)
        hand = _bodies(side, skeleton, wrist_m, forearm, start)
        found_m = np.full(points_m.shape[:2], np.nan)
        if views.is_seen[rows].any():
            evidence = _evidence(hand, skeleton, points_m, views, rows, cameras)
            refine(hand, skeleton, evidence, usual_m, body.frame_rate_hz, _NUM_STEPS)
            if cameras:
                sigma_m = uncertainty_m(hand, skeleton, evidence, body.frame_rate_hz)
                found_m = np.where(views.is_seen[rows, None], sigma_m, np.nan)
        turned = continuous_quat_xyzw(Rotation.from_matrix(hand.local[:, WRIST_JOINT]))
        if rows.start and turned[0] @ quat[rows.start] < 0:
            turned = -turned
        joined_quat.add(rows, turned)
        joined_rad.add(rows, hand.angle_rad[:, -NUM_HINGES:])
        joined_m.add(rows, found_m)
    pose = HandPose(Rotation.from_quat(quat), angle_rad)
    return FittedHand(pose, all_sigma_m[:, 1:] if cameras and views.is_seen.any() else None)


def wrist_of(side: Side, body: SkeletonMotion, rows: slice) -> tuple[Float[np.ndarray, "rows 3"], Rotation]:
    """World positions of a wrist (metres) and orientations of its forearm in a range of frames."""
    shown = replace(body, root_m=body.root_m[rows], parent_from_joint=body.parent_from_joint[rows])
    wrist_m, _ = joint_pose(shown, f"{side.capitalize()}Hand")
    _, forearm = joint_pose(shown, f"{side.capitalize()}ForeArm")
    return wrist_m, forearm


def fingers_m(
    side: Side, body: SkeletonMotion, bone_length_m: Float[np.ndarray, " whole"], pose: HandPose, rows: slice
) -> Float[np.ndarray, "rows joints 3"]:
    """World positions of the joints of all fingers (metres), in the order of ``finger_joints``."""
    wrist_m, forearm = wrist_of(side, body, rows)
    shown = HandPose(pose.forearm_from_hand[rows], pose.angle_rad[rows])
    skeleton = articulate_hand(side, bone_length_m)
    return landmarks_of(_bodies(side, skeleton, wrist_m, forearm, shown), skeleton)[:, 1:]


def _bodies(
    side: Side, skeleton: Articulation, wrist_m: Float[np.ndarray, "frames 3"], forearm: Rotation, pose: HandPose
) -> JointPoses:
    """Joints of a hand on the body's wrist; hinges are clipped to their limits."""
    angle_rad = np.zeros((len(wrist_m), skeleton.num_freedoms))
    hinges = slice(-NUM_HINGES, None)
    angle_rad[:, hinges] = np.clip(pose.angle_rad, skeleton.lowest_rad[hinges], skeleton.highest_rad[hinges])
    local = local_rotations(side, forearm.as_matrix(), pose.forearm_from_hand.as_matrix(), angle_rad[:, hinges])
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
    start_m = landmarks_of(start, skeleton)
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
