"""Fusion of a body's joints with BlazePose's heatmaps, read near these joints."""

import numpy as np
from jaxtyping import Float

from pipeline.detect.topdown.blazepose import LANDMARKS, SURE_PEAK, PoseOutputs, score_of_peak
from pipeline.detect.topdown.joint_maps import (
    SHARED_JOINTS,
    SHARED_LANDMARKS,
    common_marks_px,
    landmark_offsets_px,
)
from pipeline.joints import COCO_17

_SHARED = COCO_17.indices(SHARED_JOINTS)


def fuse(
    keypoints_px: Float[np.ndarray, "joints 2"], score: Float[np.ndarray, " joints"], pose: PoseOutputs | None
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Average the joints of a body with the heatmaps' maxima near them.

    Alone, BlazePose takes limbs of other people in a crowd. Near a joint of this body it can't. The weights are the
    squares of the joint's score and of the heatmap's peak.

    Parameters
    ----------
    keypoints_px, score
        Joints of ``COCO_17`` in pixels of the image, NaN where missing, and their scores.
    pose
        Outputs of BlazePose for the body; ``None`` for a body without a crop.

    Returns
    -------
        Common marks of both networks in pixels of the image; see ``joint_maps``. A joint without a sure heatmap near it
        is the detector's alone. And scores: those of the surer network, 0 where the detector found no joint.
    """
    if pose is None:
        return common_marks_px(keypoints_px), score
    offsets_px = landmark_offsets_px(keypoints_px)
    joints_px, weight = keypoints_px[_SHARED], score[_SHARED] ** 2
    expected_px = np.full((len(LANDMARKS), 2), np.nan)
    expected_px[list(SHARED_LANDMARKS)] = joints_px + offsets_px
    read_px, peak = (read[list(SHARED_LANDMARKS)] for read in pose.near(expected_px))
    peak_weight = np.where(peak >= SURE_PEAK, peak**2, 0.0)
    share = peak_weight / np.maximum(weight + peak_weight, np.finfo(float).tiny)
    step_px = share[:, None] * (read_px - offsets_px - joints_px)
    fused_px = keypoints_px.copy()
    fused_px[_SHARED] += np.where(share[:, None] > 0, step_px, 0.0)
    surest = score.copy()
    surest[_SHARED] = np.where(share > 0, np.maximum(score[_SHARED], score_of_peak(peak)), score[_SHARED])
    return common_marks_px(fused_px), surest
