"""Decoder of MoveNet MultiPose: bodies from centre peaks, joints from heatmap peaks near their regressed positions.

The heads are maps with one cell for every 4 pixels of the network's input. ``center`` (1 channel) and ``heatmap`` (one
channel a joint) hold confidences. ``regress`` holds, at a body's centre, the vectors in cells to its joints.
``offset`` holds, at a joint's peak, the vector from the cell to the joint. The channels of these two alternate y and x.
As in MoveNet (https://blog.tensorflow.org/2021/05/next-generation-pose-detection-with-movenet-and-tensorflowjs.html), a
joint is the peak with the greatest heat divided by its distance to the regressed position. Unlike in MoveNet, a peak
belongs to at most one body.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.arrays import read_only
from pipeline.detection.bodies import ImageBodies, boxes_around

_STRIDE_PX = 4
_MIN_CENTER_SCORE = 0.3
# Peaks with less heat are noise; association uses a higher limit.
_MIN_JOINT_SCORE = 0.05
# Limits the size of arrays; a network of this size can't tell as many people apart.
_MAX_BODIES = 200
# MoveNet's value: cells that are added to the distance by which the heat is divided.
_DISTANCE_BIAS = 1.8
# Largest distance of a peak from the regressed position, as a share of the body's size.
_MAX_DISTANCE = 0.3
# Bodies are duplicates if this share of their common joints is closer than this share of the body's size.
_DUPLICATE_SHARE = 0.7
_DUPLICATE_DISTANCE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Peaks of the heatmaps, padded with heat 0 to the same number for every joint."""

    cell_yx: Int[np.ndarray, "joints candidates 2"]  # Row and column of the peak's cell
    joint_px: Float[np.ndarray, "joints candidates 2"]  # Position (x, y) of the joint in pixels of the network's input
    heat: Float[np.ndarray, "joints candidates"]  # Confidence of the peak


def decode_movenet(outputs: Mapping[str, np.ndarray]) -> ImageBodies:
    """Decode the four heads of one image.

    They are ``center`` (1, 1, h, w), ``heatmap`` (1, joints, h, w), ``offset`` and ``regress`` (1, 2 joints, h, w).
    Bodies are in pixels of the network's input, without duplicates; each peak is a joint of at most one body.
    """
    center, heatmap, offset, regress = (outputs[head][0] for head in ("center", "heatmap", "offset", "regress"))
    centers_yx, center_score = _find_centers(center)
    candidates = _find_candidates(heatmap, offset)
    affinity = _affinity(candidates, centers_yx, regress)
    nearest_px, _ = _pick(candidates, affinity.argmax(-1), affinity.max(-1) > 0)
    # Duplicates are removed before peaks are assigned: else a duplicate would take other people's joints.
    distinct = _without_duplicates(nearest_px)
    keypoints_px, score = _pick(candidates, *_choose_exclusively(affinity[distinct]))
    seen = (score > 0).any(-1)
    keypoints_px, score, center_score = keypoints_px[seen], score[seen], center_score[distinct][seen]
    return ImageBodies(
        keypoints_px=read_only(keypoints_px),
        score=read_only(score),
        box_px=read_only(boxes_around(keypoints_px)),
        center_score=read_only(center_score),
    )


def _find_peaks(
    maps: Float[np.ndarray, "channels height width"], min_value: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Channel, row and column of all cells above ``min_value`` that are the greatest of their 3x3 neighbourhood.

    The first of equal neighbours is the peak.
    """
    padded = np.pad(maps, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
    width = padded.shape[2]
    flat = padded.ravel()
    cells = np.flatnonzero(flat > min_value)
    before = np.array([-width - 1, -width, -width + 1, -1])
    value = flat[cells, None]
    is_peak = (value > flat[cells[:, None] + before]).all(-1) & (value >= flat[cells[:, None] - before]).all(-1)
    channel, row, column = np.unravel_index(cells[is_peak], padded.shape)
    return channel, row - 1, column - 1


def _find_centers(
    center: Float[np.ndarray, "1 height width"],
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Cells (y, x) of the bodies' centres and their scores, in descending order of the score."""
    _, row, column = _find_peaks(center, _MIN_CENTER_SCORE)
    score = center[0, row, column].astype(np.float64)
    order = np.argsort(-score, kind="stable")[:_MAX_BODIES]
    return np.stack([row, column], axis=-1)[order], score[order]


def _find_candidates(
    heatmap: Float[np.ndarray, "joints height width"], offset: Float[np.ndarray, "coordinates height width"]
) -> _Candidates:
    num_joints = len(heatmap)
    joint, row, column = _find_peaks(heatmap, _MIN_JOINT_SCORE)
    num_peaks = np.bincount(joint, minlength=num_joints)
    slot = np.arange(len(joint)) - (np.cumsum(num_peaks) - num_peaks)[joint]
    shape = (num_joints, max(1, num_peaks.max()))
    cell_yx = np.zeros((*shape, 2), np.int64)
    joint_px = np.full((*shape, 2), np.nan)
    heat = np.zeros(shape)
    cell_yx[joint, slot] = np.stack([row, column], axis=-1)
    joint_px[joint, slot, 0] = (column + offset[2 * joint + 1, row, column]) * _STRIDE_PX
    joint_px[joint, slot, 1] = (row + offset[2 * joint, row, column]) * _STRIDE_PX
    heat[joint, slot] = heatmap[joint, row, column]
    return _Candidates(cell_yx, joint_px, heat)


def _affinity(
    candidates: _Candidates,
    centers_yx: Int[np.ndarray, "n 2"],
    regress: Float[np.ndarray, "coordinates height width"],
) -> Float[np.ndarray, "n joints candidates"]:
    """Affinity of each peak with each body: heat over the distance to the regressed position, 0 if too far away."""
    to_joints = regress[:, centers_yx[:, 0], centers_yx[:, 1]].T.reshape(len(centers_yx), len(candidates.heat), 2)
    expected_yx = centers_yx[:, None] + to_joints
    body_size = np.linalg.norm(np.ptp(expected_yx, axis=1), axis=-1)
    distance = np.linalg.norm(expected_yx[:, :, None] - candidates.cell_yx, axis=-1)
    near = distance <= _MAX_DISTANCE * body_size[:, None, None] + _DISTANCE_BIAS
    return np.where(near, candidates.heat / (distance + _DISTANCE_BIAS), 0.0)


def _choose_exclusively(
    affinity: Float[np.ndarray, "n joints candidates"],
) -> tuple[Int[np.ndarray, "n joints"], Bool[np.ndarray, "n joints"]]:
    """Assign each peak to at most one body, in descending order of affinity.

    Without this rule, overlapping people would share peaks, and one of the bodies would be a mixture of both people.
    Returns the candidate of each joint, and whether it has one.
    """
    num_bodies, num_joints, num_candidates = affinity.shape
    choice = np.zeros((num_bodies, num_joints), np.int64)
    is_found = np.zeros((num_bodies, num_joints), bool)
    joints = np.arange(num_joints)
    left = affinity.transpose(1, 0, 2).copy()
    # Each round assigns every joint's best remaining peak; ties go to the body with the higher score.
    for _ in range(num_bodies):
        body, peak = np.divmod(left.reshape(num_joints, -1).argmax(-1), num_candidates)
        fits = left[joints, body, peak] > 0
        choice[body[fits], joints[fits]] = peak[fits]
        is_found[body[fits], joints[fits]] = True
        left[joints, body] = 0
        left[joints, :, peak] = 0
    return choice, is_found


def _pick(
    candidates: _Candidates, choice: Int[np.ndarray, "n joints"], is_found: Bool[np.ndarray, "n joints"]
) -> tuple[Float[np.ndarray, "n joints 2"], Float[np.ndarray, "n joints"]]:
    """Joints in pixels of the network's input, NaN where not found, and their scores, 0 where not found."""
    joints = np.arange(choice.shape[1])
    keypoints_px = np.where(is_found[..., None], candidates.joint_px[joints, choice], np.nan)
    return keypoints_px, np.where(is_found, candidates.heat[joints, choice], 0.0)


def _without_duplicates(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Int[np.ndarray, " kept"]:
    """Indices of the bodies that are not duplicates of an earlier body, ascending."""
    box_px = boxes_around(keypoints_px)
    size_px = np.linalg.norm(box_px[:, 2:] - box_px[:, :2], axis=-1)
    distance_px = np.linalg.norm(keypoints_px[:, None] - keypoints_px[None], axis=-1)
    num_common = np.isfinite(distance_px).sum(-1)
    num_same = (distance_px <= _DUPLICATE_DISTANCE * size_px[:, None, None]).sum(-1)
    is_same = (num_same > 0) & (num_same >= _DUPLICATE_SHARE * num_common)
    kept: list[int] = []
    for body in range(len(keypoints_px)):
        if not is_same[kept, body].any():
            kept.append(body)
    return np.array(kept, np.int64)
