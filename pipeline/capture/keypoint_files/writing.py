"""Keypoint files of a frame in OpenPose's form, which ``folders`` reads."""

import json

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import BODY_25, COCO_17, FINGER_JOINTS, SIDES, JointSet, finger_joints

# Joints of BODY_25 that are the middle of two joints of COCO-17.
_MIDDLES = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}


def encode_frame(
    keypoints_px: Float[np.ndarray, "n joints 2"], score: Float[np.ndarray, "n joints"], joints: JointSet
) -> bytes:
    """Encode the bodies of a frame: bodies of COCO-17 as they are, others as BODY_25 with hands of 21 points.

    ``keypoints_px``: joints in pixels, NaN where a joint was not found.
    """
    # OpenPose writes zeros for a joint that it did not find.
    found = np.nan_to_num(np.concatenate([keypoints_px, score[..., None]], axis=-1))
    parts = _parts(found, joints)
    listed = [{name: points[person].ravel().tolist() for name, points in parts.items()} for person in range(len(found))]
    return json.dumps({"version": 1.3, "people": listed}, separators=(",", ":")).encode()


def _parts(found: Float[np.ndarray, "n joints 3"], joints: JointSet) -> dict[str, Float[np.ndarray, "n points 3"]]:
    """Keypoints of each entry of a person in OpenPose's files: x, y and score."""
    if joints == COCO_17:
        return {"pose_keypoints_2d": found}
    parts = {"pose_keypoints_2d": _body_25(found, joints)}
    if not FINGER_JOINTS.isdisjoint(joints.names):
        for side in SIDES:
            parts[f"hand_{side}_keypoints_2d"] = found[:, joints.indices((f"{side}_wrist", *finger_joints(side)))]
    return parts


def _body_25(found: Float[np.ndarray, "n joints 3"], joints: JointSet) -> Float[np.ndarray, "n 25 3"]:
    """Keypoints of BODY_25: neck and middle of the hips are middles of two joints; small toes are not found."""
    keypoints = np.zeros((len(found), len(BODY_25.names), 3))
    for column, name in enumerate(BODY_25.names):
        if name in joints.names:
            keypoints[:, column] = found[:, joints.index(name)]
        elif name in _MIDDLES:
            pair = found[:, joints.indices(_MIDDLES[name])]
            both = np.all(pair[..., 2] > 0, axis=-1)
            middle = np.append(pair[..., :2].mean(1), pair[..., 2:].min(1), axis=-1)
            keypoints[:, column] = np.where(both[:, None], middle, 0.0)
    return keypoints
