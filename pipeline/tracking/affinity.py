"""How well targets and detections fit: 2D and 3D correspondence (Chen et al. 2020, eq. 1-5), and two views (eq. 13).

Affinities are means over the joints that both sides have, where the paper writes sums: their sign and order within a
detection stay, and a half-hidden body is not penalised. A joint's term is cut at -1, so that a single wrong wrist does
not outvote a body.
"""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.geometry.epipolar import epipolar_distance_px
from pipeline.tracking.parameters import TrackingParameters

# Fewer shared joints are no evidence.
_MIN_JOINTS = 3


def predict(
    xyz_m: Float[np.ndarray, "*batch joints 3"],
    velocity_m_s: Float[np.ndarray, "*batch joints 3"],
    age_s: Float[np.ndarray, "*batch joints"],
    max_extrapolation_s: float,
) -> Float[np.ndarray, "*batch joints 3"]:
    """Linear motion (eq. 5), standing still after ``max_extrapolation_s``."""
    return xyz_m + velocity_m_s * np.minimum(age_s, max_extrapolation_s)[..., None]


def ray_distance_m(
    points_m: Float[np.ndarray, "*#batch 3"],
    center_m: Float[np.ndarray, "*#batch 3"],
    rays: Float[np.ndarray, "*batch 3"],
) -> Float[np.ndarray, "*batch"]:
    """Distance d of points to the rays from a camera centre (eq. 4); infinite behind the camera, NaN for NaN."""
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
    """2D correspondence A2D with the last match in the same camera (eq. 2), NaN where one side has no joint."""
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
    """3D correspondence A3D of predicted joints and rays (eq. 4), NaN where one side has no joint."""
    targets, detections = np.broadcast_arrays(predicted_m[:, None], rays[None])
    distance_m = ray_distance_m(targets, center_m, detections)
    decay = np.exp(-parameters.lambda_a_hz * age_s)[:, None]
    return parameters.weight_3d * np.maximum(1 - distance_m / parameters.alpha_3d_m, -1.0) * decay


def affinity(
    terms_2d: Float[np.ndarray, "targets detections joints"], terms_3d: Float[np.ndarray, "targets detections joints"]
) -> Float[np.ndarray, "targets detections"]:
    """Affinity A of targets and detections (eq. 1), -inf where they share too few joints."""
    shared = np.isfinite(terms_3d)
    count = shared.sum(-1)
    total = np.where(shared, terms_3d, 0.0) + np.where(shared & np.isfinite(terms_2d), terms_2d, 0.0)
    return np.where(count >= _MIN_JOINTS, total.sum(-1) / np.maximum(count, 1), -np.inf)


def epipolar_affinity(
    fundamental: Float[np.ndarray, "3 3"],
    left_px: Float[np.ndarray, "left joints 2"],
    right_px: Float[np.ndarray, "right joints 2"],
    alpha_px: float,
) -> Float[np.ndarray, "left right"]:
    """Affinity A_e of detections in two cameras (eq. 12-13), -inf where they share too few joints."""
    left, right = np.broadcast_arrays(left_px[:, None], right_px[None])
    terms = np.maximum(1 - epipolar_distance_px(fundamental, left, right) / alpha_px, -1.0)
    shared: Bool[np.ndarray, "left right joints"] = np.isfinite(terms)
    count = shared.sum(-1)
    total = np.where(shared, terms, 0.0).sum(-1)
    return np.where(count >= _MIN_JOINTS, total / np.maximum(count, 1), -np.inf)
