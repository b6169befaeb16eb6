"""Grouping of peaks to bodies in one image, limb by limb (Cao et al., CVPR 2017, section 2.4)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from pipeline.core.data.arrays import read_only
from pipeline.detection.bodies import ImageBodies
from pipeline.detection.decoders.fields import ImageFields
from pipeline.geometry.fields import connectivity

# OpenPose's values: least share of a limb that lies on its field, and least number of joints and mean limb score of a
# body.
_LEAST_SHARE = 0.8
_MIN_JOINTS = 4
_MIN_LIMB_SCORE = 0.2
_MIN_PEAK_SCORE = 0.1


def group(image: ImageFields, limbs: Int[np.ndarray, "limbs 2"], num_joints: int) -> ImageBodies:
    """Group peaks to bodies.

    ``limbs``: first and second joint of each field's limb, ordered from the root: except for the first limbs, the first
    joint of a limb is the second joint of an earlier limb. Returns bodies in pixels of the image, in descending order
    of the sum of their limbs' scores; ``center_score`` is the mean of the limbs' scores.
    """
    of_joint = [np.flatnonzero((image.joint == j) & (image.score >= _MIN_PEAK_SCORE)) for j in range(num_joints)]
    body_of = np.full(len(image.joint), -1)
    bodies: list[dict[int, int]] = []
    scores: list[list[float]] = []
    for number, (first, second) in enumerate(limbs.tolist()):
        for begin, end, score in _joined(image, number, of_joint[first], of_joint[second]):
            body = int(body_of[begin])
            if body_of[end] >= 0:
                continue
            if body < 0:
                body = len(bodies)
                bodies.append({first: begin})
                scores.append([])
                body_of[begin] = body
            if second not in bodies[body]:
                bodies[body][second] = end
                scores[body].append(score)
                body_of[end] = body
    sure = [
        k
        for k, peaks in enumerate(bodies)
        if len(peaks) >= _MIN_JOINTS and sum(scores[k]) / len(scores[k]) >= _MIN_LIMB_SCORE
    ]
    sure.sort(key=lambda k: -sum(scores[k]))
    center_score = np.array([min(1.0, sum(scores[k]) / len(scores[k])) for k in sure])
    return _bodies(image, [bodies[k] for k in sure], center_score, num_joints)


def _joined(image: ImageFields, limb: int, firsts: np.ndarray, seconds: np.ndarray) -> list[tuple[int, int, float]]:
    """Pairs of peaks joined by a limb, with scores, in descending order of the score; each peak is in one pair."""
    begin, end = np.repeat(firsts, len(seconds)), np.tile(seconds, len(firsts))
    cells = image.grid.map_from_image(image.points_px)
    mean, share = connectivity(image.fields, np.full(len(begin), limb), cells[begin], cells[end])
    # OpenPose's prior against limbs longer than half of the image.
    length = np.linalg.norm(cells[end] - cells[begin], axis=-1)
    score = mean + np.minimum(0.5 * image.fields.shape[2] / np.maximum(length, 1e-6) - 1.0, 0.0)
    possible = np.flatnonzero((share >= _LEAST_SHARE) & (score > 0.0))
    pairs: list[tuple[int, int, float]] = []
    taken: set[int] = set()
    for k in possible[np.argsort(-score[possible], kind="stable")].tolist():
        if begin[k] not in taken and end[k] not in taken:
            taken |= {int(begin[k]), int(end[k])}
            pairs.append((int(begin[k]), int(end[k]), float(score[k])))
    return pairs


def _bodies(
    image: ImageFields, chosen: Sequence[dict[int, int]], center_score: np.ndarray, num_joints: int
) -> ImageBodies:
    keypoints_px = np.full((len(chosen), num_joints, 2), np.nan)
    score = np.zeros((len(chosen), num_joints))
    for k, peaks in enumerate(chosen):
        joints, numbers = list(peaks), list(peaks.values())
        keypoints_px[k, joints], score[k, joints] = image.points_px[numbers], image.score[numbers]
    corners_px = [reduce(keypoints_px, axis=1) for reduce in (np.fmin.reduce, np.fmax.reduce)]
    return ImageBodies(
        keypoints_px=read_only(keypoints_px),
        score=read_only(score),
        box_px=read_only(np.concatenate(corners_px, axis=-1)),
        center_score=read_only(center_score),
    )
