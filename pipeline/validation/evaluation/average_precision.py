"""Average precision of 3D poses: the protocol of VoxelPose (Tu, Wang and Zeng, ECCV 2020) for CMU Panoptic.

Each pose of an instant is compared with the true person of the least mean joint distance. Poses of all instants are
taken by falling score. A pose is right at a threshold if its distance is below it and the person is not taken yet.

- *AP*: area under the curve of precision over recall, precision being the best at this recall or a higher one. At
  thresholds of 25 to 150 mm, with their mean.
- *Recall*: share of true people with a pose within 500 mm that is nearest to them.
- *MPJPE*: mean distance of the poses that are right at 500 mm.

Joints are compared that the truth and the pose have. Networks give all joints; a pose that lacks more than half of a
person's joints is not compared with the person.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.validation.evaluation.mpjpe import select_joints

THRESHOLDS_MM = (25, 50, 75, 100, 125, 150)
FAR_MM = 500
"""Threshold of recall and MPJPE."""

_MIN_SHARED = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class InstantPoses:
    """Poses that were found at one instant."""

    xyz_m: Float[np.ndarray, "poses joints 3"]  # World positions, NaN where a joint is absent
    score: Float[np.ndarray, " poses"]  # Mean confidence of the observed joints, 0 without any


@dataclass(frozen=True, slots=True)
class PoseScores:
    """Figures of the module's protocol; ``None`` without data."""

    ap: Mapping[int, float | None]  # By threshold in millimetres, fractions of 1
    mean_ap: float | None
    recall_500: float | None
    mpjpe_500_mm: float | None


def poses_at(
    tracks: Sequence[Track3D], joints: JointSet, names: Sequence[str], frames: Int[np.ndarray, " frames"]
) -> list[InstantPoses]:
    """Gather the poses of tracks at output frames, -1 for a frame that does not exist.

    ``names`` are joints of the joint set. A track has a pose at a frame if it has any of the joints there.
    """
    taken_m = select_joints(tracks, joints, names, frames)
    has_pose = np.isfinite(taken_m).all(-1).any(-1)
    scores = np.zeros(has_pose.shape)
    for row, track in enumerate(tracks):
        for column in np.flatnonzero(has_pose[row]):
            of_joints = track.score[frames[column] - track.start_frame]
            scores[row, column] = of_joints[of_joints > 0].mean() if (of_joints > 0).any() else 0.0
    return [
        InstantPoses(taken_m[has_pose[:, column], column], scores[has_pose[:, column], column])
        for column in range(len(frames))
    ]


def score_poses(predicted: Sequence[InstantPoses], truth_m: Sequence[Float[np.ndarray, "_ joints 3"]]) -> PoseScores:
    """Score poses by the protocol of the module.

    ``predicted``, ``truth_m``: one of each for an instant, with the same joints. Unknown true joints are NaN.
    """
    distance_mm, person, score = [np.empty(0)], [np.empty(0, int)], [np.empty(0)]
    num_people = 0
    for poses, people_m in zip(predicted, truth_m, strict=True):
        apart_mm = 1000 * _distance_m(poses.xyz_m, people_m)
        if len(people_m) and len(poses.score):
            nearest = apart_mm.argmin(1)
            distance_mm.append(apart_mm[np.arange(len(nearest)), nearest])
            person.append(num_people + nearest)
        else:
            distance_mm.append(np.full(len(poses.score), np.inf))
            person.append(np.full(len(poses.score), -1))
        score.append(poses.score)
        num_people += len(people_m)
    order = np.argsort(-np.concatenate(score), kind="stable")
    distances, people = np.concatenate(distance_mm)[order], np.concatenate(person)[order]
    ap = {
        threshold: _average_precision(_right(distances, people, threshold), num_people) for threshold in THRESHOLDS_MM
    }
    near = _right(distances, people, FAR_MM)
    return PoseScores(
        ap=ap,
        mean_ap=float(np.mean([value or 0.0 for value in ap.values()])) if num_people else None,
        recall_500=len(np.unique(people[distances < FAR_MM])) / num_people if num_people else None,
        mpjpe_500_mm=float(distances[near].mean()) if near.any() else None,
    )


def _distance_m(
    poses_m: Float[np.ndarray, "poses joints 3"], people_m: Float[np.ndarray, "people joints 3"]
) -> Float[np.ndarray, "poses people"]:
    """Mean distance of the joints that a pose and a person share; infinite if they are too few."""
    apart_m = np.linalg.norm(poses_m[:, None] - people_m, axis=-1)
    is_shared = np.isfinite(apart_m)
    count, known = is_shared.sum(-1), np.isfinite(people_m).all(-1).sum(-1)
    mean_m = np.where(is_shared, apart_m, 0.0).sum(-1) / np.maximum(count, 1)
    return np.where((count > 0) & (count >= _MIN_SHARED * known), mean_m, np.inf)


def _right(
    distance_mm: Float[np.ndarray, " poses"], person: Int[np.ndarray, " poses"], threshold_mm: float
) -> np.ndarray:
    """Poses, by falling score, that are the first one near their person."""
    near = np.flatnonzero(distance_mm < threshold_mm)
    right = np.zeros(len(distance_mm), bool)
    right[near[np.unique(person[near], return_index=True)[1]]] = True
    return right


def _average_precision(is_right: np.ndarray, num_people: int) -> float | None:
    """Area under the curve of interpolated precision over recall."""
    if not num_people:
        return None
    num_right = np.cumsum(is_right)
    precision = num_right / np.arange(1, len(is_right) + 1)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float(best[is_right].sum() / num_people)
