"""Scores on MVOR: errors of joints in 3D by the number of cameras, false people, and joints in 2D.

Eight joints are scored in 3D: shoulders, hips, elbows and wrists. Their truth is known for some people only.

- *MPJPE, PCK150, recall*: see ``evaluation.mpjpe``. Average precision: see ``evaluation.average_precision``.
- *Cameras of a person*: those in which a detection with more than two of the eight joints is the person's, as in
  the data set's evaluation of 3D poses. In each picture detections and people are paired one to one by the mean
  distance of joints, at most a quarter of the person's larger side.
- *False people*: share of the poses that match no person and show no other person in the pictures: fewer than
  two cameras have a box of any person with at least half of the pose's joints.
- *PCK in 2D*: the data set's own. A joint is right within a fifth of the larger side of the person's joints; of the
  detections whose joints cover three tenths of the person's box, the one of the highest score counts. Joints that
  are not annotated count as wrong, and left and right, and head and neck, are averaged.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.cameras import Camera
from pipeline.core.data.detections import Detections
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.average_precision import InstantPoses, score_poses
from pipeline.validation.evaluation.datasets.mvor import JOINTS, MvorBenchmark, MvorInstant
from pipeline.validation.evaluation.mpjpe import UNMATCHED, accuracy, match_frames

SCORED_JOINTS = JOINTS[2:]
"""Joints that are scored in 3D."""

_MIN_JOINTS = 3
_NEAR_SIZE = 0.25
_PCK_SIZE = 0.2
_MIN_COVERED = 0.3
_MIN_CAMERAS = 2
_KINDS = ("shoulder", "hip", "elbow", "wrist")
# Joints of COCO from which the head is taken, the first that are detected.
_HEAD: Sequence[tuple[str, ...]] = (
    ("left_eye", "right_eye"),
    ("left_ear", "right_ear"),
    ("nose",),
    ("right_eye",),
    ("left_eye",),
    ("right_ear",),
    ("left_ear",),
)


def score_mvor(
    predicted: Sequence[InstantPoses], benchmark: MvorBenchmark, detections: Mapping[str, Detections]
) -> dict[str, Any]:
    """Score poses of ``SCORED_JOINTS``, one entry an instant, at the instants at which people are annotated in 3D.

    ``detections`` have COCO's joints, from which the poses were made, with the instants' numbers as frames.

    The result has:

    - ``instants``, ``people``: number of the scored instants, and of the people who are annotated in 3D.
    - ``mpjpe_mm``, ``pck150``, ``recall``, ``mpjpe_by_joint_mm``: of all people.
    - ``by_cameras``: people, recall and errors by the number of cameras that detected the person.
    - ``false_people``: share of all poses.
    - ``mean_ap``, ``ap``, ``recall_500``, ``mpjpe_500_mm``: see ``evaluation.average_precision``.
    """
    scored = [number for number, instant in enumerate(benchmark.instants) if len(instant.truth_m)]
    truth_m = [benchmark.instants[number].truth_m[:, 2:] for number in scored]
    poses = [predicted[number] for number in scored]
    predicted_m, true_m = _stacked([each.xyz_m for each in poses]), _stacked(truth_m)
    matched = match_frames(predicted_m, true_m)
    error_m = _errors_m(predicted_m, true_m, matched)
    cameras = np.full(true_m.shape[:2], -1)
    for column, number in enumerate(scored):
        cameras[: len(truth_m[column]), column] = _num_cameras(number, benchmark, detections)
    whole = accuracy(predicted_m, true_m)
    by_pose = score_poses(poses, truth_m)
    num_poses = sum(len(each.score) for each in poses)
    num_false = sum(
        _num_false(each.xyz_m, set(matched[:, column].tolist()), benchmark.instants[number], benchmark.cameras)
        for column, (number, each) in enumerate(zip(scored, poses, strict=True))
    )
    return {
        "instants": len(scored),
        "people": sum(map(len, truth_m)),
        "mpjpe_mm": whole.mpjpe_mm,
        "pck150": whole.pck150,
        "recall": whole.recall,
        "false_people": num_false / num_poses if num_poses else None,
        "mpjpe_by_joint_mm": _by_joint_mm(error_m),
        "by_cameras": {
            count: {
                "people": int((cameras == count).sum()),
                "recall": float((matched[cameras == count] != UNMATCHED).mean()) if (cameras == count).any() else None,
                "mpjpe_by_joint_mm": _by_joint_mm(error_m[cameras == count]),
            }
            for count in range(len(benchmark.cameras) + 1)
        },
        "mean_ap": by_pose.mean_ap,
        "ap": dict(by_pose.ap),
        "recall_500": by_pose.recall_500,
        "mpjpe_500_mm": by_pose.mpjpe_500_mm,
    }


def score_joints_2d(
    detections: Mapping[str, Detections],
    body_scores: Mapping[str, Float[np.ndarray, " bodies"]],
    benchmark: MvorBenchmark,
) -> dict[str, float | None]:
    """PCK of detections of COCO's joints in 2D, by kind of joint and their mean, fractions of 1.

    ``body_scores`` are the detections' scores, which are compared with each other only.
    """
    right: list[Bool[np.ndarray, " joints"]] = []
    for number, instant in enumerate(benchmark.instants):
        for camera, picture in zip(benchmark.cameras, instant.pictures, strict=True):
            rows = np.flatnonzero(detections[camera.name].frame == number)
            bodies_px, scores = detections[camera.name].keypoints_px[rows], body_scores[camera.name][rows]
            right += [_right_joints(bodies_px, scores, joints_px) for joints_px in picture.joints_px]
    if not right:
        return dict.fromkeys(("head", *_KINDS, "mean"))
    of_pairs = np.mean(right, axis=0).reshape(-1, 2).mean(1)
    by_kind = dict(zip(("head", *_KINDS), of_pairs.tolist(), strict=True))
    return by_kind | {"mean": float(of_pairs.mean())}


def _stacked(rows: Sequence[Float[np.ndarray, "_ joints 3"]]) -> Float[np.ndarray, "rows instants joints 3"]:
    """Rows of all instants in one array, NaN where an instant has fewer."""
    stacked = np.full((max(map(len, rows), default=0), len(rows), len(SCORED_JOINTS), 3), np.nan)
    for column, of_instant in enumerate(rows):
        stacked[: len(of_instant), column] = of_instant
    return stacked


def _errors_m(
    predicted_m: Float[np.ndarray, "poses instants joints 3"],
    truth_m: Float[np.ndarray, "people instants joints 3"],
    matched: Int[np.ndarray, "people instants"],
) -> Float[np.ndarray, "people instants joints"]:
    no_person = np.full((1, *truth_m.shape[1:]), np.nan)
    of_match_m = np.concatenate([predicted_m, no_person])[matched, np.arange(truth_m.shape[1])]
    return np.linalg.norm(of_match_m - truth_m, axis=-1)


def _by_joint_mm(error_m: Float[np.ndarray, "*batch joints"]) -> dict[str, float | None]:
    """Mean error by kind of joint, and the mean of the kinds as in the data set's evaluation."""
    by_kind: dict[str, float | None] = {}
    for position, kind in enumerate(_KINDS):
        of_kind_m = error_m[..., 2 * position : 2 * position + 2]
        known = np.isfinite(of_kind_m)
        by_kind[kind] = 1000 * float(of_kind_m[known].mean()) if known.any() else None
    values = [value for value in by_kind.values() if value is not None]
    return by_kind | {"average": float(np.mean(values)) if values else None}


def _num_cameras(
    number: int, benchmark: MvorBenchmark, detections: Mapping[str, Detections]
) -> Int[np.ndarray, " people"]:
    """Number of the cameras that detected each person of an instant."""
    people_m = benchmark.instants[number].truth_m[:, 2:]
    count = np.zeros(len(people_m), int)
    for camera in benchmark.cameras:
        of_camera = detections[camera.name]
        bodies_px = of_camera.keypoints_px[of_camera.frame == number][:, COCO_17.indices(SCORED_JOINTS)]
        bodies_px = bodies_px[np.isfinite(bodies_px).all(-1).sum(-1) >= _MIN_JOINTS]
        truth_px = project(camera, people_m)
        apart_px = np.linalg.norm(truth_px[:, None] - bodies_px, axis=-1)
        is_shared = np.isfinite(apart_px)
        mean_px = np.where(is_shared, apart_px, 0.0).sum(-1) / np.maximum(is_shared.sum(-1), 1)
        relative = np.where(is_shared.any(-1), mean_px / _sizes_px(truth_px)[:, None], np.inf)
        # A pair beyond the limit costs more than all others together, and is left out.
        cost = np.minimum(relative, 1.0 + _NEAR_SIZE * len(people_m))
        people, columns = linear_sum_assignment(cost)
        count[people[cost[people, columns] <= _NEAR_SIZE]] += 1
    return count


def _sizes_px(points_px: Float[np.ndarray, "people joints 2"]) -> Float[np.ndarray, " people"]:
    """Larger side of the points of each person, infinite without any."""
    known = np.isfinite(points_px).all(-1, keepdims=True)
    high, low = (
        np.where(known, points_px, -np.inf).max(1, initial=-np.inf),
        np.where(known, points_px, np.inf).min(1, initial=np.inf),
    )
    sizes = (high - low).max(-1, initial=0.0)
    return np.where(known.any((1, 2)), np.maximum(sizes, 1.0), np.inf)


def _num_false(
    poses_m: Float[np.ndarray, "poses joints 3"], matched: set[int], instant: MvorInstant, cameras: Sequence[Camera]
) -> int:
    """Number of the poses of an instant that are no person."""
    free_m = poses_m[[row for row in range(len(poses_m)) if row not in matched]]
    in_boxes = np.zeros(len(free_m), int)
    for camera, picture in zip(cameras, instant.pictures, strict=True):
        points_px = project(camera, free_m)[:, None]
        low, high = picture.box_px[:, None, :2], picture.box_px[:, None, 2:]
        inside = ((points_px >= low) & (points_px <= high)).all(-1).sum(-1)
        known = np.isfinite(free_m).all(-1).sum(-1)
        in_boxes += (2 * inside >= known[:, None]).any(1)
    return int((in_boxes < _MIN_CAMERAS).sum())


def _right_joints(
    bodies_px: Float[np.ndarray, "bodies 17 2"],
    scores: Float[np.ndarray, " bodies"],
    joints_px: Float[np.ndarray, "10 2"],
) -> Bool[np.ndarray, " 10"]:
    """Annotated joints of a person that are found."""
    if not len(bodies_px):
        return np.zeros(len(JOINTS), bool)
    low, high = np.nanmin(joints_px, axis=0), np.nanmax(joints_px, axis=0)
    body_low = np.where(np.isfinite(bodies_px), bodies_px, np.inf).min(1)
    body_high = np.where(np.isfinite(bodies_px), bodies_px, -np.inf).max(1)
    common = np.clip(np.minimum(high, body_high) - np.maximum(low, body_low) + 1, 0, None).prod(-1)
    covering = np.flatnonzero(common / (high - low + 1).prod() > _MIN_COVERED)
    if not len(covering):
        return np.zeros(len(JOINTS), bool)
    body_px = _as_annotated(bodies_px[covering[scores[covering].argmax()]])
    return np.linalg.norm(body_px - joints_px, axis=-1) <= _PCK_SIZE * (high - low + 1).max()


def _as_annotated(body_px: Float[np.ndarray, "17 2"]) -> Float[np.ndarray, "10 2"]:
    """The data set's ten joints of a detection, by its own rules."""

    def mean_error(*rules: tuple[str, ...]) -> np.ndarray:
        of_rules = (body_px[COCO_17.indices(names)].mean(0) for names in rules)
        return next((point for point in of_rules if np.isfinite(point).all()), np.full(2, np.nan))

    neck = mean_error(("left_shoulder", "right_shoulder"), ("right_shoulder",), ("left_shoulder",))
    return np.stack([mean_error(*_HEAD), neck, *body_px[COCO_17.indices(SCORED_JOINTS)]])
