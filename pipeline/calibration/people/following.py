"""Bodies followed from frame to frame through the images of one camera, without geometry."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

from pipeline.calibration.people.following_kernels import VELOCITY_FRAMES, measure_shifts
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

_Tracklet = list[int]  # Numbers of the bodies of a tracklet

MAX_GAP_S = 0.25
"""Longest gap over which a body is followed, and over which its joints are interpolated."""


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
    points_px, body_s = points_px[is_body], time_s[detected.frame[is_body]]
    starts = np.searchsorted(detected.frame[is_body], np.arange(len(time_s) + 1)).tolist()
    done: list[_Tracklet] = []
    growing: list[_Tracklet] = []
    for frame in np.unique(detected.frame).tolist():
        is_near = [time_s[frame] - body_s[tracklet[-1]] <= MAX_GAP_S for tracklet in growing]
        done += compress(growing, map(operator.not_, is_near))
        growing = list(compress(growing, is_near))
        bodies = range(starts[frame], starts[frame + 1])
        growing, ended = _continued(growing, bodies, points_px, body_s)
        done += ended
    return [Followed(body_s[tracklet], points_px[tracklet]) for tracklet in (*done, *growing)]


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
    growing: list[_Tracklet],
    bodies: range,
    points_px: Float[np.ndarray, "n joints 2"],
    body_s: Float[np.ndarray, " n"],
) -> tuple[list[_Tracklet], list[_Tracklet]]:
    """Continue tracklets with the bodies of a frame.

    Returns tracklets that go on, new ones included, and those that end because more than one body may be theirs.
    """
    shift = np.full((len(growing), len(bodies)), np.inf)
    if shift.size:
        early, last = np.array([[rows[-VELOCITY_FRAMES:][0], rows[-1]] for rows in growing]).T.copy()
        values = np.empty((3, points_px.shape[1]))
        measure_shifts(points_px, body_s, early, last, bodies.start, _MIN_JOINTS, values, shift)
    rows, columns = linear_sum_assignment(np.minimum(shift, 10.0))
    going, ended = [], []
    taken: set[int] = set()
    matched = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    by_tracklet, by_body = shift.tolist(), shift.T.tolist()
    for number, tracklet in enumerate(growing):
        column = matched.get(number)
        if column is None or by_tracklet[number][column] > _MAX_SHIFT:
            going.append(tracklet)
            continue
        of_tracklet, of_body = by_tracklet[number], by_body[column]
        others = of_tracklet[:column] + of_tracklet[column + 1 :] + of_body[:number] + of_body[number + 1 :]
        if of_tracklet[column] > _AMBIGUOUS * min(others, default=np.inf):
            ended.append(tracklet)
            continue
        tracklet.append(bodies[column])
        taken.add(column)
        going.append(tracklet)
    going += [[body] for column, body in enumerate(bodies) if column not in taken]
    return going, ended


def _extents_px(points_px: Float[np.ndarray, "n joints 2"]) -> Float[np.ndarray, " n"]:
    """Larger side of the box around each body's joints."""
    return np.asarray((np.fmax.reduce(points_px, axis=1) - np.fmin.reduce(points_px, axis=1)).max(-1))
