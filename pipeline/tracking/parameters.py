"""Parameters of cross-view tracking, and how their defaults follow from the session.

The paper gives one set a data set; the rule behind them is that the 2D threshold follows the image's scale and the
penalty rates follow the frame rate. So they are derived here from cameras and frame rate, never by data set.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.data import Camera
from pipeline.geometry.camera import center_in_world

# How fast a joint's image is allowed to move before its 2D affinity turns negative: a brisk walk with swinging arms.
_JOINT_SPEED_M_S = 3.0


@dataclass(frozen=True, slots=True)
class TrackingParameters:
    """Parameters of the tracker; the first eight are the paper's.

    Parameters
    ----------
    weight_2d, weight_3d
        Weights of 2D and 3D correspondence, w2D and w3D (eq. 2 and 4).
    alpha_2d_px_s
        Threshold of the 2D speed (eq. 2).
    alpha_epipolar_px
        Threshold of the epipolar distance (alpha2D of eq. 13).
    alpha_3d_m
        Threshold of the distance between a predicted joint and a ray (eq. 4).
    lambda_a_hz
        Penalty rate of affinities (eq. 2 and 4).
    lambda_t_hz
        Penalty rate of old observations in triangulation (eq. 11).
    velocity_window_s
        Span of the recent positions behind a joint's velocity (eq. 5).
    min_score
        Joints below are not used.
    instant_s
        Frames of two cameras that are less apart show one instant: over half a period, so that cameras in opposite
        phase meet, and under a whole one, so that a camera's last frame is the past.
    confirm_instants
        A target is confirmed once two cameras saw it at so many instants.
    max_unseen_s, max_unseen_tentative_s
        A confirmed or tentative target ends when two cameras have not seen it for so long.
    max_extrapolation_s
        Predictions (eq. 5) stand still after so long.
    max_detour_m_s
        How fast somebody whom nobody sees may leave the way that he was on, and still be the same person on return:
        as people walk (preferred speed, Bohannon 1997).
    duplicate_m
        Two targets whose joints are on average closer than this are one person.
    """

    alpha_2d_px_s: float
    alpha_epipolar_px: float
    lambda_a_hz: float
    lambda_t_hz: float
    instant_s: float
    weight_2d: float = 0.4
    weight_3d: float = 0.6
    alpha_3d_m: float = 0.15
    velocity_window_s: float = 0.2
    min_score: float = 0.15
    confirm_instants: int = 3
    max_unseen_s: float = 2.0
    max_unseen_tentative_s: float = 0.2
    max_extrapolation_s: float = 0.25
    max_detour_m_s: float = 1.4
    duplicate_m: float = 0.2


def viewed_point_m(cameras: Sequence[Camera]) -> np.ndarray:
    """Where the optical axes meet: the point with the least summed squared distance to all axes."""
    axes = np.array([camera.cam_from_world.rotation[2] for camera in cameras])
    centers_m = np.array([center_in_world(camera) for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    # Parallel axes leave the depth open; the small term puts the point near the cameras' middle then.
    left = across.sum(0) + 1e-3 * np.eye(3)
    right = np.einsum("cab,cb->a", across, centers_m) + 1e-3 * centers_m.mean(0)
    return np.linalg.solve(left, right)


def pixels_per_metre(cameras: Sequence[Camera]) -> float:
    """Median over the cameras of focal length over distance to the viewed point."""
    target_m = viewed_point_m(cameras)
    return float(
        np.median(
            [
                (camera.matrix[0, 0] + camera.matrix[1, 1]) / 2 / max(1.0, np.linalg.norm(target_m - center))
                for camera in cameras
                for center in [center_in_world(camera)]
            ]
        )
    )


def derive_parameters(cameras: Sequence[Camera], frame_rate_hz: float) -> TrackingParameters:
    """Defaults for a session.

    ``alpha_2d`` is 3 m/s seen at the viewed point, ``alpha_epipolar`` is ``alpha_3d`` seen there; the penalty rates are
    the paper's for 25 frames a second (lambda_a 5, lambda_t 10), scaled by the frame rate.
    """
    scale_px_m = pixels_per_metre(cameras)
    return TrackingParameters(
        alpha_2d_px_s=_JOINT_SPEED_M_S * scale_px_m,
        alpha_epipolar_px=0.15 * scale_px_m,
        lambda_a_hz=0.2 * frame_rate_hz,
        lambda_t_hz=0.4 * frame_rate_hz,
        instant_s=0.75 / frame_rate_hz,
    )
