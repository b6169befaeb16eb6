"""Position error and identity of predicted people against a known truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

# A prediction farther from a person than this, on average over the joints, is not that person.
GATE_M = 0.5
PCK_THRESHOLD_M = 0.15


@dataclass(frozen=True, slots=True)
class PositionScores:
    """Accuracy of a take.

    Parameters
    ----------
    mpjpe_mm
        Mean distance of predicted to true joints over all matched people and joints; NaN if nobody matched.
    pck150
        Share of all true joints that have a prediction within 150 mm.
    recall
        Share of all true joints that have a prediction at all.
    switches
        How often the track that matches a true person is another than at the person's last match.
    ghost_rate
        Share of predicted person-frames that match nobody; 0 if nothing was predicted.
    """

    mpjpe_mm: float
    pck150: float
    recall: float
    switches: int
    ghost_rate: float


def match_frame(
    predicted_m: Float[np.ndarray, "predicted joints 3"], truth_m: Float[np.ndarray, "people joints 3"]
) -> list[tuple[int, int]]:
    """Pairs (person, prediction) of least total mean joint distance (Hungarian), none beyond ``GATE_M``.

    NaN joints do not count; people or predictions without a common joint are never paired.
    """
    distance_m = np.linalg.norm(truth_m[:, None] - predicted_m[None], axis=-1)
    common = np.isfinite(distance_m)
    mean_m = np.where(common, distance_m, 0.0).sum(-1) / np.maximum(common.sum(-1), 1)
    mean_m = np.where(common.any(-1), mean_m, np.inf)
    # What lies beyond the gate costs as much as no match, so that it never displaces a match within.
    rows, columns = linear_sum_assignment(np.minimum(mean_m, GATE_M))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if mean_m[i, j] < GATE_M]


def score_positions(
    predicted_m: Sequence[Float[np.ndarray, "_ joints 3"]],
    track_ids: Sequence[Int[np.ndarray, " _"]],
    truth_m: Float[np.ndarray, "frames people joints 3"],
) -> PositionScores:
    """Score predictions frame by frame.

    Parameters
    ----------
    predicted_m, track_ids
        For every frame the predicted people, NaN for a joint that is absent, and their tracks.
    truth_m
        NaN where a person or joint is not there.
    """
    errors_m: list[Float[np.ndarray, " _"]] = []
    num_true = num_predicted = num_matched = switches = 0
    last_track: dict[int, int] = {}
    for frame, (people_m, ids) in enumerate(zip(predicted_m, track_ids, strict=True)):
        num_true += int(np.isfinite(truth_m[frame]).all(-1).sum())
        num_predicted += len(people_m)
        for person, prediction in match_frame(people_m, truth_m[frame]):
            num_matched += 1
            error_m = np.linalg.norm(people_m[prediction] - truth_m[frame, person], axis=-1)
            errors_m.append(error_m[np.isfinite(error_m)])
            track = int(ids[prediction])
            switches += last_track.get(person, track) != track
            last_track[person] = track
    all_m = np.concatenate([np.empty(0), *errors_m])
    return PositionScores(
        mpjpe_mm=float(all_m.mean() * 1000) if len(all_m) else float("nan"),
        pck150=float((all_m <= PCK_THRESHOLD_M).sum() / max(num_true, 1)),
        recall=len(all_m) / max(num_true, 1),
        switches=switches,
        ghost_rate=(num_predicted - num_matched) / max(num_predicted, 1),
    )
