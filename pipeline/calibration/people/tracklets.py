"""Tracklets: short tracks of a body in the image of one camera, kept pure rather than long."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from pipeline.data import Camera, Detections, FrameTimes, read_only
from pipeline.geometry.undistortion import undistort_px
from pipeline.joints import JointSet

JOINTS = (
    "nose", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
)  # fmt: skip
"""Joints of the body that calibrate cameras, as far as the detector finds them."""

MIN_INSTANTS = 8
"""Instants of the shortest tracklet that is kept, and that two tracklets must share to be compared."""

_MIN_SCORE = 0.3
_MIN_JOINTS = 4
# Limits of a body's shift from one frame to the next: a share of its height, and of the shift of the second-best body.
_MAX_SHIFT, _AMBIGUOUS = 0.25, 0.6
# Longest gap over which a tracklet goes on, and over which its joints are interpolated.
_MAX_GAP_S = 0.25
_STEP_S, _MAX_INSTANTS = 0.1, 1200


@dataclass(frozen=True, slots=True, eq=False)
class Tracklet:
    """A body in one camera at consecutive instants.

    Parameters
    ----------
    camera
        Number of the camera.
    first
        First instant.
    points_px
        Distorted pixels of ``JOINTS``; NaN where a joint is not seen.
    ideal
        The same points on the normalised image plane (z = 1), without distortion.
    height_px
        Median height of the body in the image.
    """

    camera: int
    first: int
    points_px: Float[np.ndarray, "instants joints 2"]
    ideal: Float[np.ndarray, "instants joints 2"]
    height_px: float

    @property
    def instants(self) -> range:
        """Instants of the rows."""
        return range(self.first, self.first + len(self.points_px))

    def shared(self, other: "Tracklet") -> range:
        """Instants that both have."""
        return range(max(self.first, other.first), min(self.instants.stop, other.instants.stop))

    def rows(self, instants: range | Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Rows of some of its instants."""
        return np.asarray(instants) - self.first


def instants_of(times: Sequence[FrameTimes]) -> Float[np.ndarray, " instants"]:
    """Instants at which the cameras are compared: 0.1 s apart, further in takes of more than two minutes."""
    begin_s = min(float(one.time_s[0]) for one in times)
    end_s = max(float(one.time_s[-1]) for one in times)
    step_s = max(_STEP_S, (end_s - begin_s) / _MAX_INSTANTS)
    return begin_s + step_s * np.arange(max(2, int((end_s - begin_s) / step_s) + 1))


def find_tracklets(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    instants_s: Float[np.ndarray, " instants"],
) -> list[Tracklet]:
    """Follow bodies through each camera's images, and sample them at instants of the session's clock.

    A tracklet ends where two bodies come so close that they may be exchanged.
    """
    return [
        found
        for number, camera in enumerate(cameras)
        for found in _of_camera(number, camera, times[camera.name].time_s, detections[camera.name], joints, instants_s)
    ]


def with_camera(tracklet: Tracklet, camera: Camera) -> Tracklet:
    """Tracklet with its normalised points under other intrinsics."""
    return Tracklet(
        tracklet.camera, tracklet.first, tracklet.points_px, _ideal(camera, tracklet.points_px), tracklet.height_px
    )


@dataclass(slots=True, eq=False)
class _Growing:
    """Tracklet that is being followed."""

    times_s: list[float] = field(default_factory=list)
    points_px: list[np.ndarray] = field(default_factory=list)

    def predicted_px(self, time_s: float) -> np.ndarray:
        """Joints at the mean velocity of the body over the last frames; NaN for joints not seen in the last one."""
        if len(self.times_s) < 2:
            return self.points_px[-1]
        back = max(0, len(self.times_s) - 4)
        moved = self.points_px[-1] - self.points_px[back]
        is_known = np.isfinite(moved).all(-1)
        if not is_known.any():
            return self.points_px[-1]
        velocity = np.median(moved[is_known], axis=0) / (self.times_s[-1] - self.times_s[back])
        return self.points_px[-1] + velocity * (time_s - self.times_s[-1])


def _of_camera(
    number: int,
    camera: Camera,
    time_s: Float[np.ndarray, " frames"],
    detected: Detections,
    joints: JointSet,
    instants_s: Float[np.ndarray, " instants"],
) -> list[Tracklet]:
    points_px = _chosen(detected, joints)
    starts = np.searchsorted(detected.frame, np.arange(len(time_s) + 1))
    done: list[_Growing] = []
    growing: list[_Growing] = []
    for frame in np.unique(detected.frame):
        now_s = float(time_s[frame])
        bodies = points_px[starts[frame] : starts[frame + 1]]
        bodies = bodies[np.isfinite(bodies).all(-1).sum(-1) >= _MIN_JOINTS]
        kept = [one for one in growing if now_s - one.times_s[-1] <= _MAX_GAP_S]
        done += [one for one in growing if now_s - one.times_s[-1] > _MAX_GAP_S]
        growing, ended = _continued(kept, bodies, now_s)
        done += ended
    found = [_sampled(number, camera, one, instants_s) for one in (*done, *growing)]
    return [one for one in found if one is not None]


def _chosen(detected: Detections, joints: JointSet) -> Float[np.ndarray, "n joints 2"]:
    """Joints of ``JOINTS``; NaN where the detector has no such joint or does not trust it."""
    points_px = np.full((len(detected.frame), len(JOINTS), 2), np.nan)
    for place, name in enumerate(JOINTS):
        if name in joints.names:
            number = joints.index(name)
            is_seen = detected.score[:, number] >= _MIN_SCORE
            points_px[is_seen, place] = detected.keypoints_px[is_seen, number]
    return points_px


def _continued(
    growing: list[_Growing], bodies: Float[np.ndarray, "bodies joints 2"], now_s: float
) -> tuple[list[_Growing], list[_Growing]]:
    """Continue tracklets with the bodies of a frame.

    Returns
    -------
        Tracklets that go on, new ones included, and those that end because more than one body may be theirs.
    """
    shift = np.full((len(growing), len(bodies)), np.inf)
    if len(growing) and len(bodies):
        predicted = np.array([one.predicted_px(now_s) for one in growing])
        shift = _shifts(predicted, bodies)
    limited = np.minimum(shift, 10.0)
    rows, columns = linear_sum_assignment(limited) if shift.size else (np.empty(0, int), np.empty(0, int))
    going, ended = [], []
    taken: set[int] = set()
    matched: dict[int, int] = {int(row): int(column) for row, column in zip(rows, columns, strict=True)}
    for number, one in enumerate(growing):
        column = matched.get(number)
        if column is None or shift[number, column] > _MAX_SHIFT:
            going.append(one)
            continue
        rivals = np.concatenate([np.delete(shift[number], column), np.delete(shift[:, column], number)])
        if shift[number, column] > _AMBIGUOUS * rivals.min(initial=np.inf):
            ended.append(one)
            continue
        one.times_s.append(now_s)
        one.points_px.append(bodies[column])
        taken.add(column)
        going.append(one)
    going += [_Growing([now_s], [body]) for column, body in enumerate(bodies) if column not in taken]
    return going, ended


def _shifts(
    predicted_px: Float[np.ndarray, "tracklets joints 2"], bodies_px: Float[np.ndarray, "bodies joints 2"]
) -> Float[np.ndarray, "tracklets bodies"]:
    """Median shift of the joints that both see, in heights of the body; infinite if they share too few."""
    distance = np.linalg.norm(predicted_px[:, None] - bodies_px[None], axis=-1)
    is_known = np.isfinite(distance)
    enough = is_known.sum(-1) >= _MIN_JOINTS
    median = np.full(enough.shape, np.inf)
    median[enough] = np.nanmedian(distance[enough], axis=-1)
    extent: np.ndarray = np.nanmax(bodies_px, axis=1) - np.nanmin(bodies_px, axis=1)
    return median / np.maximum(extent.max(-1), 1.0)


def _sampled(
    number: int, camera: Camera, growing: _Growing, instants_s: Float[np.ndarray, " instants"]
) -> Tracklet | None:
    """Interpolate a tracklet at the instants within it; ``None`` if it is too short."""
    times_s, points_px = np.array(growing.times_s), np.array(growing.points_px)
    first, stop = np.searchsorted(instants_s, [times_s[0], times_s[-1] + 1e-9])
    if stop - first < MIN_INSTANTS:
        return None
    wanted_s = instants_s[first:stop]
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, len(times_s) - 1)
    before_s, after_s = times_s[after - 1], times_s[after]
    share = ((wanted_s - before_s) / (after_s - before_s))[:, None, None]
    sampled = (1 - share) * points_px[after - 1] + share * points_px[after]
    sampled[after_s - before_s > _MAX_GAP_S] = np.nan
    extent: np.ndarray = np.nanmax(points_px, axis=1) - np.nanmin(points_px, axis=1)
    return Tracklet(number, int(first), read_only(sampled), _ideal(camera, sampled), float(np.median(extent.max(-1))))


def _ideal(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    inverse = np.linalg.inv(camera.matrix)
    return read_only(undistort_px(camera, points_px) @ inverse[:2, :2].T + inverse[:2, 2])
