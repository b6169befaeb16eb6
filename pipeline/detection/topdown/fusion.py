"""Fusion of a body's joints with BlazePose's heatmaps, read near these joints.

Two networks that learnt from different annotations mark the same joint at different places. Before their joints are
averaged, both are moved to one common mark: to the mark of the network whose mark is nearer to the centre of the joint.
The offsets were learnt from rendered people with known joints (docs/lab/detection.md). They are measured in the
image: up along the trunk, in lengths of the trunk; outwards along the line through the shoulders, in widths of the
shoulders.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.core.joints import COCO_17
from pipeline.detection.topdown.blazepose import LANDMARK, LANDMARKS, SURE_PEAK, PoseOutputs, score_of_peak


@dataclass(frozen=True, slots=True)
class ImageOffset:
    """Offset of a landmark from a joint in the image."""

    up: float = 0.0  # Component from the hips to the shoulders, in lengths of the trunk
    # Component away from the body's middle, in widths of the shoulders; 0 for joints without a side
    outwards: float = 0.0


LANDMARK_OFFSETS: Mapping[str, ImageOffset] = {
    "shoulder": ImageOffset(up=-0.025, outwards=-0.025),
    "hip": ImageOffset(up=-0.07, outwards=-0.02),
}
"""Offsets of BlazePose's landmarks from MultiPose's joints by kind of joint; 0 for a kind that is not named."""
COMMON_OFFSETS: Mapping[str, ImageOffset] = {"shoulder": ImageOffset(up=-0.025)}
"""Offsets of the common marks from MultiPose's joints by kind of joint; 0 for a kind that is not named."""
NOT_SHARED = frozenset({"left_ear", "right_ear"})
"""Joints that the networks define so differently that no offset in the image joins them."""

SHARED_JOINTS = tuple(name for name in COCO_17.names if name not in NOT_SHARED)
"""Joints of ``COCO_17`` that are read from BlazePose's heatmaps."""
SHARED_LANDMARKS = tuple(LANDMARK[name] for name in SHARED_JOINTS)
"""Landmarks of ``SHARED_JOINTS``."""

_SIGNS = {"left": 1.0, "right": -1.0}


def _shares(
    offsets: Mapping[str, ImageOffset], names: tuple[str, ...]
) -> tuple[Float[np.ndarray, " joints"], Float[np.ndarray, " joints"]]:
    """Components of the offsets of joints: up, and towards the left shoulder."""
    of_joints = [offsets.get(name.rpartition("_")[2], ImageOffset()) for name in names]
    signs = [_SIGNS.get(name.partition("_")[0], 0.0) for name in names]
    leftwards = [sign * offset.outwards for sign, offset in zip(signs, of_joints, strict=True)]
    return np.array([offset.up for offset in of_joints]), np.array(leftwards)


_LANDMARK_SHARES = _shares(LANDMARK_OFFSETS, SHARED_JOINTS)
_COMMON_SHARES = _shares(COMMON_OFFSETS, COCO_17.names)
_SHOULDERS = COCO_17.indices(("left_shoulder", "right_shoulder"))
_HIPS = COCO_17.indices(("left_hip", "right_hip"))


def landmark_offsets_px(keypoints_px: Float[np.ndarray, "joints 2"]) -> Float[np.ndarray, "shared 2"]:
    """Offsets of the landmarks from the joints of a body, for ``SHARED_JOINTS``.

    Joints are ``COCO_17`` as MultiPose marks them in pixels of the image, NaN where missing. Offsets are NaN
    where they are not 0 and a shoulder or hip is missing.
    """
    return _offsets_px(*_LANDMARK_SHARES, keypoints_px)


def common_marks_px(keypoints_px: Float[np.ndarray, "joints 2"]) -> Float[np.ndarray, "joints 2"]:
    """Move the joints of a body from MultiPose's marks to the common marks of both networks.

    They are joints of ``COCO_17`` in pixels of the image, NaN where missing, and stay as they are without both
    shoulders and both hips.
    """
    return keypoints_px + np.nan_to_num(_offsets_px(*_COMMON_SHARES, keypoints_px))


def _offsets_px(
    up: Float[np.ndarray, " n"], leftwards: Float[np.ndarray, " n"], keypoints_px: Float[np.ndarray, "joints 2"]
) -> Float[np.ndarray, "n 2"]:
    trunk_px = keypoints_px[_SHOULDERS].mean(0) - keypoints_px[_HIPS].mean(0)
    width_px = keypoints_px[_SHOULDERS[0]] - keypoints_px[_SHOULDERS[1]]
    return _scaled(up, trunk_px) + _scaled(leftwards, width_px)


def _scaled(shares: Float[np.ndarray, " n"], axis_px: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "n 2"]:
    """Multiples of an axis of the body; a share of 0 needs no axis."""
    return np.where(shares[:, None] == 0, 0.0, shares[:, None] * axis_px)


_SHARED = COCO_17.indices(SHARED_JOINTS)


def fuse(
    keypoints_px: Float[np.ndarray, "joints 2"], score: Float[np.ndarray, " joints"], pose: PoseOutputs | None
) -> tuple[Float[np.ndarray, "joints 2"], Float[np.ndarray, " joints"]]:
    """Average the joints of a body with the heatmaps' maxima near them.

    Alone, BlazePose takes limbs of other people in a crowd. Near a joint of this body it can't. The weights are the
    squares of the joint's score and of the heatmap's peak.

    ``keypoints_px``, ``score``: joints of ``COCO_17`` in pixels of the image, NaN where missing, and their scores.
    ``pose``: outputs of BlazePose for the body; ``None`` for a body without a crop. Returns common marks of both
    networks in pixels of the image. A joint without a sure heatmap near it is the detector's alone. Also returns
    scores of the surer network, 0 where the detector found no joint.
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
