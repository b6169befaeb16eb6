"""Multi-object tracking metrics MOTA and IDF1, computed by the reference implementation (``trackeval``).

- *MOTA* = 1 - (missed + false positives + identity switches) / true person-frames (CLEAR MOT, Bernardin 2008).
- *IDF1* = F1 score of person-frames, people and tracks matched one to one over the sequence (Ristani 2016).

A person and a track match in a frame if their similarity is at least 0.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from pipeline.core.errors import PipelineError


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
