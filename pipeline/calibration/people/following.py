"""Bodies followed from frame to frame through the images of one camera, without geometry."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet

JOINTS = (
    "nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""Joints of the body that calibrate cameras, as far as the detector finds them."""

_MIN_SCORE = 0.3
_MIN_JOINTS = 4
# Limits of a body's shift from one frame to the next: a share of its height, and of the shift of the second-best body.
_MAX_SHIFT, _AMBIGUOUS = 0.25, 0.6

MAX_GAP_S = 0.25
"""Longest gap over which a body is followed, and over which its joints are interpolated."""


@dataclass(slots=True, eq=False)
class _Growing:
    """Tracklet that is being followed."""

    times_s: list[float] = field(default_factory=list)
    points_px: list[np.ndarray] = field(default_factory=list)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A body in one camera's frames, one after the other."""

    times_s: Float[np.ndarray, " frames"]  # Times of the frames in which it was found
    # Distorted pixels of the joints that are followed; NaN where a joint is not seen
    points_px: Float[np.ndarray, "frames joints 2"]

    @property
    def height_px(self) -> float:
        """Median height of the body in the image: the larger side of the box around its joints."""
        return float(np.median(_extents_px(self.points_px)))


def follow_bodies(
    time_s: Float[np.ndarray, " frames"], detected: Detections, joints: JointSet, names: Sequence[str] = JOINTS
) -> list[Followed]:
    """Follow bodies from frame to frame of one camera; a body ends where another one comes so close that both may swap.

    ``names`` are the joints that are followed.
    """
    points_px = _chosen(detected, joints, names)
    is_body = np.isfinite(points_px).all(-1).sum(-1) >= _MIN_JOINTS
    points_px = points_px[is_body]
    starts = np.searchsorted(detected.frame[is_body], np.arange(len(time_s) + 1))
    done: list[_Growing] = []
    growing: list[_Growing] = []
    for frame in np.unique(detected.frame):
        now_s = float(time_s[frame])
        bodies = points_px[starts[frame] : starts[frame + 1]]
        kept = [tracklet for tracklet in growing if now_s - tracklet.times_s[-1] <= MAX_GAP_S]
        done += [tracklet for tracklet in growing if now_s - tracklet.times_s[-1] > MAX_GAP_S]
        growing, ended = _continued(kept, bodies, now_s)
        done += ended
    return [Followed(np.array(tracklet.times_s), np.array(tracklet.points_px)) for tracklet in (*done, *growing)]


def _chosen(detected: Detections, joints: JointSet, names: Sequence[str]) -> Float[np.ndarray, "n joints 2"]:
    """Joints by name; NaN where the detector has no such joint or does not trust it."""
    points_px = np.full((len(detected.frame), len(names), 2), np.nan)
    for place, name in enumerate(names):
        if name in joints.names:
            number = joints.index(name)
            is_seen = detected.score[:, number] >= _MIN_SCORE
            points_px[is_seen, place] = detected.keypoints_px[is_seen, number]
    return points_px


def _continued(
    growing: list[_Growing], bodies: Float[np.ndarray, "bodies joints 2"], now_s: float
) -> tuple[list[_Growing], list[_Growing]]:
    """Continue tracklets with the bodies of a frame.

    Returns tracklets that go on, new ones included, and those that end because more than one body may be theirs.
    """
    shift = np.full((len(growing), len(bodies)), np.inf)
    if len(growing) and len(bodies):
        shift = _shifts(_predicted_px(growing, now_s), bodies)
    rows, columns = linear_sum_assignment(np.minimum(shift, 10.0))
    going, ended = [], []
    taken: set[int] = set()
    matched = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    for number, tracklet in enumerate(growing):
        column = matched.get(number)
        if column is None or shift[number, column] > _MAX_SHIFT:
            going.append(tracklet)
            continue
        of_tracklet, of_body = shift[number].tolist(), shift[:, column].tolist()
        own = of_tracklet.pop(column)
        if own > _AMBIGUOUS * min(of_tracklet + of_body[:number] + of_body[number + 1 :], default=np.inf):
            ended.append(tracklet)
            continue
        tracklet.times_s.append(now_s)
        tracklet.points_px.append(bodies[column])
        taken.add(column)
        going.append(tracklet)
    going += [_Growing([now_s], [body]) for column, body in enumerate(bodies) if column not in taken]
    return going, ended


def _predicted_px(growing: Sequence[_Growing], time_s: float) -> Float[np.ndarray, "tracklets joints 2"]:
    """Joints at the mean velocity of the body over the last frames; NaN for joints not seen in the last one."""
    last_px = np.array([tracklet.points_px[-1] for tracklet in growing])
    last_s = np.array([tracklet.times_s[-1] for tracklet in growing])
    moved = last_px - np.array([tracklet.points_px[-4:][0] for tracklet in growing])
    since_s = last_s - np.array([tracklet.times_s[-4:][0] for tracklet in growing])
    moved[~np.isfinite(moved).all(-1)] = np.nan
    velocity = _medians(moved.swapaxes(1, 2)) / np.where(since_s > 0, since_s, 1.0)[:, None]
    velocity[np.isnan(velocity)] = 0.0
    return np.asarray(last_px + (velocity * (time_s - last_s)[:, None])[:, None])


def _shifts(
    predicted_px: Float[np.ndarray, "tracklets joints 2"], bodies_px: Float[np.ndarray, "bodies joints 2"]
) -> Float[np.ndarray, "tracklets bodies"]:
    """Median shift of the joints that both see, in heights of the body; infinite if they share too few."""
    distance = np.linalg.norm(predicted_px[:, None] - bodies_px[None], axis=-1)
    is_known = np.isfinite(distance)
    enough = is_known.sum(-1) >= _MIN_JOINTS
    median = np.full(enough.shape, np.inf)
    median[enough] = _medians(distance[enough])
    return median / np.maximum(_extents_px(bodies_px), 1.0)


def _extents_px(points_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, " n"]:
    """Larger side of the box around each body's joints."""
    return np.asarray((np.fmax.reduce(points_px, axis=1) - np.fmin.reduce(points_px, axis=1)).max(-1))


def _medians(values: Float[np.ndarray, "*n joints"]) -> Float[np.ndarray, "*n"]:
    """Medians of each row without its NaN; for small arrays much faster than NumPy's."""
    count = np.isfinite(values).sum(-1).ravel()
    ordered, rows = np.sort(values, axis=-1).reshape(-1, values.shape[-1]), np.arange(len(count))
    return np.asarray((ordered[rows, (count - 1) // 2] + ordered[rows, count // 2]) / 2).reshape(values.shape[:-1])
