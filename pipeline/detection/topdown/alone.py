"""BlazePose's landmarks by themselves, as the joints of a body, in a crop that other evidence has placed."""

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import COCO_17, JointSet
from pipeline.detection.topdown.blazepose import LANDMARK, PoseOutputs, score_of_peak
from pipeline.detection.topdown.fusion import SHARED_JOINTS, SHARED_LANDMARKS, common_marks_px, landmark_offsets_px
from pipeline.detection.topdown.topdown_detector import FOOT_JOINTS, FOOT_LANDMARKS

_SHARED = COCO_17.indices(SHARED_JOINTS)
_OF_BODY = [LANDMARK[name] for name in COCO_17.names]


def read_body(
    pose: PoseOutputs, joints: JointSet, at_common_marks: bool
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Read the joints of a body from sure heatmaps.

    ``joints``: joints that are wanted: ``COCO_17``, alone or first, and feet; others stay unknown. ``at_common_marks``:
    whether joints are at the common marks of BlazePose and MultiPose, see ``fusion``; else at MultiPose's. Returns
    pixels of the image, NaN where a joint is not sure, and scores on MultiPose's scale, 0 there.
    """
    points_px, peak = pose.refined()
    keypoints_px, score = np.full((len(joints.names), 2), np.nan), np.zeros(len(joints.names))
    body_px = points_px[_OF_BODY]
    marks_px = body_px.copy()
    marks_px[_SHARED] -= landmark_offsets_px(body_px)
    if at_common_marks:
        marks_px = common_marks_px(marks_px)
    keypoints_px[_SHARED], score[_SHARED] = marks_px[_SHARED], score_of_peak(peak[list(SHARED_LANDMARKS)])
    if FOOT_JOINTS[0] in joints.names:
        feet = joints.indices(FOOT_JOINTS)
        keypoints_px[feet], score[feet] = points_px[FOOT_LANDMARKS], score_of_peak(peak[FOOT_LANDMARKS])
    keypoints_px[score == 0] = np.nan
    return keypoints_px, score
