"""What every camera saw of one person, brought to the output instants."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.data import Detections, FrameTimes, Timebase
from pipeline.tracking.parameters import TrackingParameters


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """One camera's detections of one person, at most one a frame, ascending."""

    frame: Int[np.ndarray, " n"]
    time_s: Float[np.ndarray, " n"]
    keypoints_px: Float[np.ndarray, "n joints 2"]
    score: Float[np.ndarray, "n joints"]

    @classmethod
    def of(cls, detections: Detections, times: FrameTimes, mine: Bool[np.ndarray, " detections"]) -> "Matched":
        """Pick one person's detections; of two in a frame the one with the higher scores."""
        rows = np.flatnonzero(mine)
        strength = detections.score[rows].sum(-1)
        rows = rows[np.lexsort((-strength, detections.frame[rows]))]
        frames, first = np.unique(detections.frame[rows], return_index=True)
        rows = rows[first]
        return cls(frames, times.time_s[frames], detections.keypoints_px[rows], detections.score[rows])


def observations_at(
    timebase: Timebase, matched: Sequence[Matched], parameters: TrackingParameters
) -> tuple[int, Float[np.ndarray, "frames cameras joints 2"], Float[np.ndarray, "frames cameras joints"]]:
    """Observations of every camera at the output instants of a person's life.

    An output instant between two consecutive frames of a camera takes their linear interpolation, so that cameras that
    are not synchronised agree on the instant; its score falls with the distance to the nearer frame as old observations
    do, ``exp(-lambda_t |t - t_i|)`` (Chen et al. 2020, eq. 11). Where a neighbour is missing, a frame within half a
    period stands for the instant. Nothing is made up across missed frames.

    Returns
    -------
    start_frame
        Output frame of the first row.
    points_px
        Pixels as seen, NaN where a camera has no observation.
    score
        0 where there is none.
    """
    first_s = min(one.time_s[0] for one in matched if len(one.time_s))
    last_s = max(one.time_s[-1] for one in matched if len(one.time_s))
    half_s = 0.5 / timebase.frame_rate_hz
    start = max(0, int(np.ceil((first_s - half_s - timebase.start_time_s) * timebase.frame_rate_hz)))
    stop = int(np.floor((last_s + half_s - timebase.start_time_s) * timebase.frame_rate_hz)) + 1
    stop = min(stop, timebase.num_frames)
    instants_s = timebase.start_time_s + np.arange(start, stop) / timebase.frame_rate_hz
    points, scores = zip(
        *(_one_camera(instants_s, one, half_s, parameters.lambda_t_hz) for one in matched), strict=True
    )
    return start, np.stack(points, axis=1), np.stack(scores, axis=1)


def _one_camera(
    instants_s: Float[np.ndarray, " frames"], matched: Matched, half_s: float, lambda_t_hz: float
) -> tuple[Float[np.ndarray, "frames joints 2"], Float[np.ndarray, "frames joints"]]:
    num_joints = matched.score.shape[1]
    if not len(matched.frame):
        return np.full((len(instants_s), num_joints, 2), np.nan), np.zeros((len(instants_s), num_joints))
    after = np.clip(np.searchsorted(matched.time_s, instants_s), 0, len(matched.frame) - 1)
    before = np.clip(np.searchsorted(matched.time_s, instants_s, side="right") - 1, 0, len(matched.frame) - 1)
    to_before_s = np.abs(instants_s - matched.time_s[before])
    to_after_s = np.abs(matched.time_s[after] - instants_s)
    nearest = np.where(to_before_s <= to_after_s, before, after)
    gap_s = np.minimum(to_before_s, to_after_s)

    between = (matched.frame[after] - matched.frame[before] == 1) & (gap_s > 1e-3 * half_s)
    span_s = np.where(between, matched.time_s[after] - matched.time_s[before], 1.0)
    share = np.where(between, to_before_s / span_s, 0.0)[:, None]
    blended_px = (1 - share[..., None]) * matched.keypoints_px[before] + share[..., None] * matched.keypoints_px[after]
    blended = np.minimum(matched.score[before], matched.score[after])
    both = between[:, None] & np.isfinite(blended_px).all(-1)

    points_px = np.where(both[..., None], blended_px, matched.keypoints_px[nearest])
    score = np.where(both, blended, matched.score[nearest]) * np.exp(-lambda_t_hz * gap_s)[:, None]
    seen = (both | (gap_s <= half_s)[:, None]) & np.isfinite(points_px).all(-1)
    return np.where(seen[..., None], points_px, np.nan), np.where(seen, score, 0.0)
