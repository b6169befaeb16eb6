"""Decode the heads of MoveNet MultiPose: bodies by their centres, joints by heat map peaks near where a centre says.

The heads are maps with one cell every 4 pixels of the network's input: ``center`` (1 channel) and ``heatmap`` (one a
joint) hold confidences; ``regress`` holds, at a body's centre, the way to each of its joints in cells; ``offset``
holds, at a joint's peak, the way from the cell to the joint. The last two have y and x by turns. As in MoveNet
(https://blog.tensorflow.org/2021/05/next-generation-pose-detection-with-movenet-and-tensorflowjs.html) a joint is where
heat divided by the distance to its regressed place is greatest; unlike there, a peak belongs to one body only.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.data import read_only
from pipeline.detect.bodies import Bodies

_STRIDE_PX = 4
_MIN_CENTER_SCORE = 0.3
# Fainter peaks are noise; trackers ask for more anyway.
_MIN_JOINT_SCORE = 0.05
# Keeps the arrays small whatever the image; far more people than a network of this size can tell apart.
_MAX_BODIES = 200
# Cells that are added to a distance before a heat is divided by it; MoveNet's own.
_DISTANCE_BIAS = 1.8
# A peak farther from there than this part of the body's size is someone else's joint.
_MAX_DISTANCE = 0.3
# Two bodies are one if this share of their common joints lies within this part of the body's size.
_DUPLICATE_SHARE = 0.7
_DUPLICATE_DISTANCE = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Peaks of all joints' heat maps; joints with fewer peaks than others are filled up with heat 0.

    Parameters
    ----------
    cell_yx
        Where a peak's cell is.
    joint_px
        Where it says that the joint is, x and y.
    heat
        How sure it is.
    """

    cell_yx: Int[np.ndarray, "joints candidates 2"]
    joint_px: Float[np.ndarray, "joints candidates 2"]
    heat: Float[np.ndarray, "joints candidates"]


def decode_movenet(outputs: Mapping[str, np.ndarray]) -> Bodies:
    """Decode the four heads of one image.

    Parameters
    ----------
    outputs
        ``center`` (1, 1, h, w), ``heatmap`` (1, joints, h, w), ``offset`` and ``regress`` (1, 2 joints, h, w).

    Returns
    -------
        Bodies in pixels of the network's input, no two of them the same one and no two with a common joint.
    """
    center, heatmap, offset, regress = (outputs[head][0] for head in ("center", "heatmap", "offset", "regress"))
    centers_yx, center_score = _find_centers(center)
    candidates = _find_candidates(heatmap, offset)
    affinity = _affinity(candidates, centers_yx, regress)
    nearest_px, _ = _pick(candidates, affinity.argmax(-1), affinity.max(-1) > 0)
    # Duplicates go first: one that had to leave its joints to its twin would take other people's.
    distinct = _without_duplicates(nearest_px)
    keypoints_px, score = _pick(candidates, *_choose_exclusively(affinity[distinct]))
    seen = (score > 0).any(-1)
    keypoints_px, score, center_score = keypoints_px[seen], score[seen], center_score[distinct][seen]
    return Bodies(
        keypoints_px=read_only(keypoints_px),
        score=read_only(score),
        box_px=read_only(_boxes(keypoints_px)),
        center_score=read_only(center_score),
    )


def _find_peaks(
    maps: Float[np.ndarray, "channels height width"], min_value: float
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Channel, row and column of all cells above ``min_value`` that are the greatest of 3x3 around them.

    Of equal neighbours the first counts.
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
    """Cells (y, x) of bodies' centres and their scores, the surest first."""
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
    """How well each peak fits each body: its heat, less the farther it is from where the body's centre expects it."""
    to_joints = regress[:, centers_yx[:, 0], centers_yx[:, 1]].T.reshape(len(centers_yx), len(candidates.heat), 2)
    expected_yx = centers_yx[:, None] + to_joints
    body_size = np.linalg.norm(np.ptp(expected_yx, axis=1), axis=-1)
    distance = np.linalg.norm(expected_yx[:, :, None] - candidates.cell_yx, axis=-1)
    near = distance <= _MAX_DISTANCE * body_size[:, None, None] + _DISTANCE_BIAS
    return np.where(near, candidates.heat / (distance + _DISTANCE_BIAS), 0.0)


def _choose_exclusively(
    affinity: Float[np.ndarray, "n joints candidates"],
) -> tuple[Int[np.ndarray, "n joints"], Bool[np.ndarray, "n joints"]]:
    """Give each peak to at most one body, the one that it fits best; the others take their next best, or none.

    Where two people overlap, both would claim the same peaks and one of them would become a mixture of the two.

    Returns
    -------
        The candidate of each joint, and whether there is any.
    """
    num_bodies, num_joints, num_candidates = affinity.shape
    choice = np.zeros((num_bodies, num_joints), np.int64)
    found = np.zeros((num_bodies, num_joints), bool)
    joints = np.arange(num_joints)
    left = affinity.transpose(1, 0, 2).copy()
    # Each round gives every joint's best remaining peak away; equal ones go to the surer body.
    for _ in range(num_bodies):
        body, peak = np.divmod(left.reshape(num_joints, -1).argmax(-1), num_candidates)
        fits = left[joints, body, peak] > 0
        choice[body[fits], joints[fits]] = peak[fits]
        found[body[fits], joints[fits]] = True
        left[joints, body] = 0
        left[joints, :, peak] = 0
    return choice, found


def _pick(
    candidates: _Candidates, choice: Int[np.ndarray, "n joints"], found: Bool[np.ndarray, "n joints"]
) -> tuple[Float[np.ndarray, "n joints 2"], Float[np.ndarray, "n joints"]]:
    """Joints in network pixels, NaN where none was found, and their scores."""
    joints = np.arange(choice.shape[1])
    keypoints_px = np.where(found[..., None], candidates.joint_px[joints, choice], np.nan)
    return keypoints_px, np.where(found, candidates.heat[joints, choice], 0.0)


def _without_duplicates(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Int[np.ndarray, " kept"]:
    """Indices of the bodies that are not the same as a surer one."""
    box_px = _boxes(keypoints_px)
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


def _boxes(keypoints_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, "n 4"]:
    """x0, y0, x1, y1 around the joints of each body that has any."""
    seen = np.isfinite(keypoints_px)
    low, high = np.where(seen, keypoints_px, np.inf).min(1), np.where(seen, keypoints_px, -np.inf).max(1)
    return np.concatenate([low, high], axis=-1)
