"""Affinity of targets and detections (Chen et al. 2020, eq. 1-5), and of detections in two cameras (eq. 12-13).

Affinities are means over shared joints, where the paper uses sums: signs and the order within a detection are the
same, and a half-hidden body is not penalised. A joint's term is at least -1, so that a single wrong joint does not
decide.
"""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.association.tracking.parameters import TrackingParameters
from pipeline.geometry.epipolar import epipolar_distance_px

# Least number of shared joints for an affinity.
_MIN_JOINTS = 3


def predict(
    xyz_m: Float[np.ndarray, "*batch joints 3"],
    velocity_m_s: Float[np.ndarray, "*batch joints 3"],
    age_s: Float[np.ndarray, "*batch joints"],
    max_extrapolation_s: float,
) -> Float[np.ndarray, "*batch joints 3"]:
    """Predict positions by linear motion (eq. 5); predictions stand still after ``max_extrapolation_s``."""
    return xyz_m + velocity_m_s * np.minimum(age_s, max_extrapolation_s)[..., None]


def ray_distance_m(
    points_m: Float[np.ndarray, "*#batch 3"],
    center_m: Float[np.ndarray, "*#batch 3"],
    rays: Float[np.ndarray, "*batch 3"],
) -> Float[np.ndarray, "*batch"]:
    """Distance d of points to unit rays from a camera centre (eq. 4).

    Distances are in metres; infinite for points behind the camera, NaN where an input is NaN.
    """
    offset_m = points_m - center_m
    along_m = (offset_m * rays).sum(-1)
    across_m = np.linalg.norm(offset_m - along_m[..., None] * rays, axis=-1)
    return np.where(along_m < 0, np.inf, across_m)


def correspondence_2d(
    points_px: Float[np.ndarray, "detections joints 2"],
    last_px: Float[np.ndarray, "targets joints 2"],
    gap_s: Float[np.ndarray, " targets"],
    parameters: TrackingParameters,
) -> Float[np.ndarray, "targets detections joints"]:
    """2D correspondence A2D of detections with the targets' last match in the same camera (eq. 2).

    Pixels are undistorted, NaN where a joint is unseen; ``gap_s`` is the time since each target's last match in this
    camera. A2D is NaN where the target or the detection lacks the joint.
    """
    moved_px = np.linalg.norm(points_px[None] - last_px[:, None], axis=-1)
    allowed_px = parameters.alpha_2d_px_s * gap_s[:, None, None]
    decay = np.exp(-parameters.lambda_a_hz * gap_s)[:, None, None]
    return parameters.weight_2d * np.maximum(1 - moved_px / allowed_px, -1.0) * decay


def correspondence_3d(
    rays: Float[np.ndarray, "detections joints 3"],
    center_m: Float[np.ndarray, " 3"],
    predicted_m: Float[np.ndarray, "targets joints 3"],
    age_s: Float[np.ndarray, "targets joints"],
    parameters: TrackingParameters,
) -> Float[np.ndarray, "targets detections joints"]:
    """3D correspondence A3D of predicted joints and viewing rays (eq. 4).

    Parameters
    ----------
    rays, center_m
        Unit rays of the detections' joints in the world, NaN where a joint is unseen, and the camera's centre.
    predicted_m, age_s
        Predicted joints, NaN where unknown, and the time since they were located.

    Returns
    -------
        A3D, NaN where the target or the detection lacks the joint.
    """
    targets, detections = np.broadcast_arrays(predicted_m[:, None], rays[None])
    distance_m = ray_distance_m(targets, center_m, detections)
    decay = np.exp(-parameters.lambda_a_hz * age_s)[:, None]
    return parameters.weight_3d * np.maximum(1 - distance_m / parameters.alpha_3d_m, -1.0) * decay


def affinity(
    terms_2d: Float[np.ndarray, "targets detections joints"], terms_3d: Float[np.ndarray, "targets detections joints"]
) -> Float[np.ndarray, "targets detections"]:
    """Affinity A of targets and detections (eq. 1): mean over shared joints of A2D + A3D.

    It is ``-inf`` for a pair that shares fewer than three joints.
    """
    shared = np.isfinite(terms_3d)
    total = np.where(shared, terms_3d, 0.0) + np.where(shared & np.isfinite(terms_2d), terms_2d, 0.0)
    return _mean_over_joints(total, shared)


def epipolar_affinity(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "left joints 2"],
    right_px: Float[np.ndarray, "right joints 2"],
    alpha_px: float,
) -> Float[np.ndarray, "left right"]:
    """Affinity A_e of detections in two cameras (eq. 12-13).

    Parameters
    ----------
    fundamental
        Fundamental matrix of the left and the right camera; see ``geometry.epipolar``.
    left_px, right_px
        Undistorted pixels, NaN where a joint is unseen.
    alpha_px
        Epipolar distance at which the affinity is 0.

    Returns
    -------
        A_e; ``-inf`` for a pair that shares fewer than three joints.
    """
    left, right = np.broadcast_arrays(left_px[:, None], right_px[None])
    terms = np.maximum(1 - epipolar_distance_px(fundamental, left, right) / alpha_px, -1.0)
    shared: Bool[np.ndarray, "left right joints"] = np.isfinite(terms)
    return _mean_over_joints(np.where(shared, terms, 0.0), shared)


def _mean_over_joints(
    terms: Float[np.ndarray, "*batch joints"], shared: Bool[np.ndarray, "*batch joints"]
) -> Float[np.ndarray, "*batch"]:
    """Mean of the shared joints' terms, the others being 0; ``-inf`` for too few shared joints."""
    count = shared.sum(-1)
    return np.where(count >= _MIN_JOINTS, terms.sum(-1) / np.maximum(count, 1), -np.inf)
