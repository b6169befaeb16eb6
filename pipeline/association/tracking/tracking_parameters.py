"""Parameters of cross-view tracking, and their defaults for a session.

The paper gives a set of parameters for each data set: the 2D threshold follows the scale of the image, and the penalty
rates follow the frame rate. This module derives them from the cameras and the frame rate instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world

# Speed of a joint above which its 2D affinity is negative: a brisk walk with swinging arms.
_JOINT_SPEED_M_S = 3.0
# Preferred walking speed (Bohannon 1997).
_WALK_M_S = 1.4
_ALPHA_3D_M = 0.15
_CONFIRM_INSTANTS = 3
# Rate up to which people are found at each instant by itself: photographs are numbered by seconds, however far apart
# they were taken.
_INSTANTS_HZ = 1.0
_MAX_UNSEEN_S = 2.0


@dataclass(frozen=True, slots=True)
class TrackingParameters:
    """Parameters of the tracker; the first eight are the paper's."""

    alpha_2d_px_s: float  # Threshold of the 2D speed (eq. 2)
    alpha_epipolar_px: float  # Threshold of the epipolar distance (alpha2D of eq. 13)
    lambda_a_hz: float  # Penalty rate of affinities (eq. 2 and 4)
    lambda_t_hz: float  # Penalty rate of old observations in triangulation (eq. 11)
    # Time within which frames of two cameras show the same instant. It is longer than half a period, so that cameras in
    # opposite phase match, and shorter than a period, so that it excludes a camera's previous frame.
    instant_s: float
    # Weights of 2D and 3D correspondence, w2D and w3D (eq. 2 and 4)
    weight_2d: float = 0.4
    weight_3d: float = 0.6
    alpha_3d_m: float = _ALPHA_3D_M  # Threshold of the distance between a predicted joint and a ray (eq. 4)
    velocity_window_s: float = 0.2  # Span of the recent positions behind a joint's velocity (eq. 5)
    min_score: float = 0.15  # Least score of a joint that is used
    confirm_instants: int = _CONFIRM_INSTANTS  # Number of instants at which two cameras must see a target to confirm it
    # Time after which a confirmed or a tentative target ends if no two cameras see it
    max_unseen_s: float = _MAX_UNSEEN_S
    max_unseen_tentative_s: float = 0.2
    max_extrapolation_s: float = 0.25  # Time after which predictions (eq. 5) stand still
    # Speed at which a lost target may leave its predicted path and still be matched on return
    max_detour_m_s: float = _WALK_M_S
    duplicate_m: float = 0.2  # Mean joint distance below which two targets are the same person


def viewed_point_m(cameras: Sequence[Camera]) -> np.ndarray:
    """Point with the least sum of squared distances to the cameras' optical axes, in world coordinates, metres."""
    axes = np.array([camera.cam_from_world.rotation[2] for camera in cameras])
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # Parallel axes do not determine the depth; the small term then puts the point near the centre of the cameras.
    left = across.sum(0) + 1e-3 * np.eye(3)
    right = np.einsum("cab,cb->a", across, centers_m) + 1e-3 * centers_m.mean(0)
    return np.linalg.solve(left, right)


def derive_parameters(cameras: Sequence[Camera], frame_rate_hz: float) -> TrackingParameters:
    """Derive the default parameters of a session.

    ``alpha_2d`` is 3 m/s and ``alpha_epipolar`` is ``alpha_3d``, both projected at the viewed point. Penalty rates are
    the paper's for 25 frames a second (lambda_a 5, lambda_t 10), scaled by the frame rate.

    Up to a frame a second targets end before the next frame: a person near the place of another person in the frame
    before would be taken for that one.

    A single instant confirms a person where people walk farther than ``alpha_3d`` from one frame to the next, as in
    time-lapse and photographs: without a velocity the target can't be matched again. Tracks that may be chance are left
    out afterwards (``identity.spurious_tracks``).
    """
    target_m = viewed_point_m(cameras)
    scale_px_m = float(
        np.median(
            [
                (camera.matrix[0, 0] + camera.matrix[1, 1]) / 2 / max(1.0, np.linalg.norm(target_m - center))
                for camera in cameras
                for center in [center_in_world(camera)]
            ]
        )
    )
    may_follow = _ALPHA_3D_M * frame_rate_hz >= _WALK_M_S
    instant_s = 0.75 / frame_rate_hz
    return TrackingParameters(
        alpha_2d_px_s=_JOINT_SPEED_M_S * scale_px_m,
        alpha_epipolar_px=_ALPHA_3D_M * scale_px_m,
        lambda_a_hz=0.2 * frame_rate_hz,
        lambda_t_hz=0.4 * frame_rate_hz,
        instant_s=instant_s,
        confirm_instants=_CONFIRM_INSTANTS if may_follow else 1,
        max_unseen_s=_MAX_UNSEEN_S if frame_rate_hz > _INSTANTS_HZ else instant_s,
    )
