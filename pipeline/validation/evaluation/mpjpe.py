"""Accuracy of tracks against ground truth: joint errors, missed people, ghosts and identity switches.

- *Matching*: in each frame, tracks and people are paired one to one by the Hungarian algorithm on the mean distance of
  shared joints. Pairs beyond the gate (0.5 m) are excluded. The matching has the largest number of pairs, and among
  these matchings the least sum of distances.
- *MPJPE*: mean distance of the shared joints of all matched pairs in millimetres, without alignment.
- *PCK150*: share of all true joints, matched or not, whose match lies within 150 mm (inclusive).
- *Recall*: share of true person-frames that are matched.
- *Switches*: number of matches of a person with a different track than at the person's previous match. Two people who
  swap tracks in a frame count as two switches. A person who is lost and matched again by the same track counts as none.
- *Ghost rate*: share of predicted person-frames that are unmatched. A track counts in the frames in which it has any
  of the joints.

A figure without data is ``None``.

Multi-object tracking metrics are computed by the reference implementation (``trackeval``):

- *MOTA* = 1 - (missed + false positives + identity switches) / true person-frames (CLEAR MOT, Bernardin 2008).
- *IDF1* = F1 score of person-frames, people and tracks matched one to one over the sequence (Ristani 2016).

A person and a track match in a frame if their similarity is at least 0.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.people import Track3D
from pipeline.core.errors import PipelineError
from pipeline.core.joints import COCO_17, JointSet

_NUM_FACE_JOINTS = 5
BODY_JOINTS = COCO_17.names[_NUM_FACE_JOINTS:]
"""Twelve joints of COCO-17 that are scored, without the face's joints: shoulders, arms, hips and legs."""
GATE_M = 0.5
"""Largest mean joint distance of a matched pair."""
UNMATCHED = -1
"""Number of the track of an unmatched person."""

_PCK_M = 0.15


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy of tracks; the module defines the figures. Rates are fractions of 1."""

    mpjpe_mm: float | None
    pck150: float | None
    recall: float | None
    switches: int
    ghost_rate: float | None


def select_joints(
    tracks: Sequence[Track3D], joints: JointSet, names: Sequence[str], frames: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "tracks frames names 3"]:
    """Gather joints of tracks at some output frames in one array.

    Numbers of frames are -1 for none. World positions are NaN there, for names that ``joints`` lacks, and for frames
    outside of a track.
    """
    taken = np.full((len(tracks), len(frames), len(names), 3), np.nan)
    shared = [k for k, name in enumerate(names) if name in joints.names]
    columns = [joints.index(names[k]) for k in shared]
    for row, track in enumerate(tracks):
        local = frames - track.start_frame
        inside = np.flatnonzero((frames >= 0) & (local >= 0) & (local < track.num_frames))
        taken[row, inside[:, None], shared] = track.xyz_m[local[inside]][:, columns]
    return taken


def match_frames(
    predicted_m: Float[np.ndarray, "tracks frames joints 3"],
    truth_m: Float[np.ndarray, "people frames joints 3"],
    gate_m: float = GATE_M,
) -> Int[np.ndarray, "people frames"]:
    """Match tracks to people frame by frame.

    ``predicted_m``, ``truth_m``: world positions, NaN where a joint is unknown or a person is absent. ``gate_m``:
    largest mean joint distance of a match. Returns index of the matched track for each person and frame, ``UNMATCHED``
    for no track.
    """
    matched = np.full(truth_m.shape[:2], UNMATCHED)
    for frame in range(truth_m.shape[1]):
        distance_m = mean_distance_m(predicted_m[:, frame], truth_m[:, frame])
        near = distance_m <= gate_m
        # An excluded pair costs more than any sum of distances within the gate, so that the number of pairs decides.
        cost = np.where(near, distance_m, 1.0 + gate_m * (1 + min(near.shape)))
        people, tracks = linear_sum_assignment(cost)
        paired = near[people, tracks]
        matched[people[paired], frame] = tracks[paired]
    return matched


def mean_distance_m(
    predicted_m: Float[np.ndarray, "tracks joints 3"], truth_m: Float[np.ndarray, "people joints 3"]
) -> Float[np.ndarray, "people tracks"]:
    """Mean distance of the joints that a person and a track share; infinite if they share none."""
    distance_m = np.linalg.norm(truth_m[:, None] - predicted_m, axis=-1)
    shared = np.isfinite(distance_m)
    count = shared.sum(-1)
    total_m = np.where(shared, distance_m, 0.0).sum(-1)
    return np.where(count > 0, total_m / np.maximum(count, 1), np.inf)


def count_switches(matched: Int[np.ndarray, "people frames"]) -> int:
    """Count matches of a person with a different track than at the person's previous match."""
    histories = (row[row != UNMATCHED] for row in matched)
    return sum(int(np.count_nonzero(np.diff(history))) for history in histories)


def accuracy(
    predicted_m: Float[np.ndarray, "tracks frames joints 3"],
    truth_m: Float[np.ndarray, "people frames joints 3"],
    gate_m: float = GATE_M,
) -> Accuracy:
    """Score tracks against the truth.

    World positions are of the same joints, NaN where a joint is unknown or a person is absent; ``gate_m`` is the
    largest mean joint distance of a match.
    """
    matched = match_frames(predicted_m, truth_m, gate_m)
    people, frames = np.nonzero(matched != UNMATCHED)
    error_m = np.linalg.norm(predicted_m[matched[people, frames], frames] - truth_m[people, frames], axis=-1)
    known_m = error_m[np.isfinite(error_m)]
    is_true = np.isfinite(truth_m).all(-1)
    num_predicted = int(np.isfinite(predicted_m).all(-1).any(-1).sum())
    return Accuracy(
        mpjpe_mm=float(known_m.mean()) * 1000 if len(known_m) else None,
        pck150=_share(int((known_m <= _PCK_M).sum()), int(is_true.sum())),
        recall=_share(len(people), int(is_true.any(-1).sum())),
        switches=count_switches(matched),
        ghost_rate=_share(num_predicted - len(people), num_predicted),
    )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None


@dataclass(frozen=True, slots=True, eq=False)
class MotFrame:
    """True people and tracks of one frame."""

    # Numbers of the people and of the tracks in the frame
    truth_ids: Int[np.ndarray, " people"]
    track_ids: Int[np.ndarray, " tracks"]
    similarity: Float[np.ndarray, "people tracks"]  # Similarity of each person and track, in [0, 1]


@dataclass(frozen=True, slots=True)
class MotScores:
    """Scores of a sequence; ``mota`` and ``idf1`` are ``None`` for a sequence without true people."""

    mota: float | None
    idf1: float | None
    false_positives: int
    missed: int
    switches: int


def score_mot(frames: Sequence[MotFrame]) -> MotScores:
    """Compute the scores of a sequence of frames. Raises ``PipelineError`` if ``trackeval`` is not installed."""
    try:
        from trackeval.metrics import CLEAR, Identity  # noqa: PLC0415 - an extra, and slow to import
    except ImportError as error:
        raise PipelineError("MOTA and IDF1 need the extra `evaluation`: pip install multicap[evaluation].") from error
    truth_ids = np.unique(np.concatenate([np.empty(0, np.int64), *(frame.truth_ids for frame in frames)]))
    track_ids = np.unique(np.concatenate([np.empty(0, np.int64), *(frame.track_ids for frame in frames)]))
    num_true = sum(len(frame.truth_ids) for frame in frames)
    data = {
        "num_timesteps": len(frames),
        "num_gt_ids": len(truth_ids),
        "num_tracker_ids": len(track_ids),
        "num_gt_dets": num_true,
        "num_tracker_dets": sum(len(frame.track_ids) for frame in frames),
        "gt_ids": [np.searchsorted(truth_ids, frame.truth_ids) for frame in frames],
        "tracker_ids": [np.searchsorted(track_ids, frame.track_ids) for frame in frames],
        "similarity_scores": [frame.similarity for frame in frames],
    }
    clear = CLEAR({"PRINT_CONFIG": False}).eval_sequence(data)
    identity = Identity({"PRINT_CONFIG": False}).eval_sequence(data)
    false_positives, missed, switches = (int(clear[name]) for name in ("CLR_FP", "CLR_FN", "IDSW"))
    return MotScores(
        mota=1.0 - (false_positives + missed + switches) / num_true if num_true else None,
        idf1=float(identity["IDF1"]) if num_true else None,
        false_positives=false_positives,
        missed=missed,
        switches=switches,
    )


def box_overlap(ours_px: Float[np.ndarray, "n 4"], theirs_px: Float[np.ndarray, "m 4"]) -> Float[np.ndarray, "n m"]:
    """Intersection over union of all pairs of boxes x0, y0, x1, y1; 0 for empty boxes."""
    low = np.maximum(ours_px[:, None, :2], theirs_px[None, :, :2])
    high = np.minimum(ours_px[:, None, 2:], theirs_px[None, :, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=-1)
    areas = [np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1) for boxes in (ours_px, theirs_px)]
    union = areas[0][:, None] + areas[1][None, :] - shared
    return np.where(union > 0, shared / np.maximum(union, 1e-12), 0.0)
