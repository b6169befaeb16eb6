"""Accuracy of tracks against a known truth: joint errors, missed people, ghosts and identity switches.

- *Matching*: in every frame by itself, tracks and people are paired one to one by the Hungarian algorithm on the mean
  distance over the joints that both have. Pairs beyond the gate (0.5 m) are never made; as many pairs as possible are,
  and among these the ones with the least sum of distances.
- *MPJPE*: mean distance over all joints of all matched pairs that both have, in millimetres. Nothing is aligned.
- *PCK150*: share of all true joints, matched or not, whose match lies within 150 mm (inclusive).
- *Recall*: share of true person-frames that are matched.
- *Switches*: a person's match is another track than at the person's last match. Two people who swap tracks are two
  switches, at one frame; a person who is lost and found again by the same track is none.
- *Ghost rate*: share of predicted person-frames that are unmatched. A track counts in the frames in which it has any
  of the joints.

A figure without any data is ``None``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.data import Track3D
from pipeline.joints import JointSet

BODY_JOINTS = (
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
"""The twelve joints that are scored: no face."""
GATE_M = 0.5
"""Pairs whose joints are farther apart on average are no match."""
UNMATCHED = -1
"""The match of a person in a frame in which no track is near."""

_PCK_M = 0.15


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy of tracks, as the module defines it; rates are fractions of 1."""

    mpjpe_mm: float | None
    pck150: float | None
    recall: float | None
    switches: int
    ghost_rate: float | None


def select_joints(
    tracks: Sequence[Track3D], joints: JointSet, names: Sequence[str], frames: Int[np.ndarray, " frames"]
) -> Float[np.ndarray, "tracks frames names 3"]:
    """Tracks as one array over the frames that are scored.

    Parameters
    ----------
    joints
        Those of the tracks; a name that it lacks is NaN throughout.
    frames
        Output frames to take; one that a track does not reach, such as -1, is NaN.
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
    """Match tracks to people in every frame by itself.

    Parameters
    ----------
    predicted_m, truth_m
        World positions, NaN where a joint is unknown or somebody absent.
    gate_m
        Largest mean joint distance of a match.

    Returns
    -------
        For every person and frame the index of the matched track, ``UNMATCHED`` where there is none.
    """
    matched = np.full(truth_m.shape[:2], UNMATCHED)
    for frame in range(truth_m.shape[1]):
        distance_m = mean_distance_m(predicted_m[:, frame], truth_m[:, frame])
        near = distance_m <= gate_m
        # Worth more than any sum of distances within the gate: first many pairs, then close ones.
        cost = np.where(near, distance_m, 1.0 + gate_m * (1 + min(near.shape)))
        people, tracks = linear_sum_assignment(cost)
        paired = near[people, tracks]
        matched[people[paired], frame] = tracks[paired]
    return matched


def mean_distance_m(
    predicted_m: Float[np.ndarray, "tracks joints 3"], truth_m: Float[np.ndarray, "people joints 3"]
) -> Float[np.ndarray, "people tracks"]:
    """Mean distance over the joints that both have; infinite where they share none."""
    distance_m = np.linalg.norm(truth_m[:, None] - predicted_m, axis=-1)
    shared = np.isfinite(distance_m)
    count = shared.sum(-1)
    total_m = np.where(shared, distance_m, 0.0).sum(-1)
    return np.where(count > 0, total_m / np.maximum(count, 1), np.inf)


def count_switches(matched: Int[np.ndarray, "people frames"]) -> int:
    """How often a person's match is another track than at the person's last match."""
    histories = (row[row != UNMATCHED] for row in matched)
    return sum(int(np.count_nonzero(np.diff(history))) for history in histories)


def accuracy(
    predicted_m: Float[np.ndarray, "tracks frames joints 3"],
    truth_m: Float[np.ndarray, "people frames joints 3"],
    gate_m: float = GATE_M,
) -> Accuracy:
    """Score tracks against the truth, frame by frame.

    Parameters
    ----------
    predicted_m, truth_m
        World positions of the same joints, NaN where a joint is unknown or somebody absent.
    gate_m
        Largest mean joint distance of a match.
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
