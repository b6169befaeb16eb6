"""Sightings: joints of people in several cameras, chosen all over the take and the volume."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import People, Poses3D
from pipeline.core.joints import FINGER_JOINTS, JointSet
from pipeline.geometry.tracks import triangulate_instants

MAX_POINTS = 3000
"""Largest number of points; more take longer and hardly move the cameras: errors of a detector last."""

_MIN_SCORE = 0.3
_STEP_S, _MIN_INSTANTS = 0.1, 50
_CELL_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class JointSightings:
    """Joints of people, each seen by at least two cameras at one instant."""

    time_s: Float[np.ndarray, " points"]  # Time of each point on the session's clock
    # Distorted pixels of the full image; NaN where a camera does not see the point
    points_px: Float[np.ndarray, "points cameras 2"]
    # Number of the joint, and of the square of the floor on which the person is
    joint: Int[np.ndarray, " points"]
    square: Int[np.ndarray, " points"]

    def __len__(self) -> int:
        return len(self.time_s)

    def subset(self, chosen: Bool[np.ndarray, " points"]) -> "JointSightings":
        """Select points."""
        return JointSightings(self.time_s[chosen], self.points_px[chosen], self.joint[chosen], self.square[chosen])

    def triangulated(self, cameras: Sequence[Camera]) -> Float[np.ndarray, "points 3"]:
        """World coordinates; NaN where fewer than two cameras see the point, or all rays are parallel."""
        return triangulate_instants(cameras, self.points_px[:, :, None])[:, 0]

    def without(self, hidden: Bool[np.ndarray, "points cameras"]) -> "JointSightings":
        """Leave out views, and the points that fewer than two cameras see then."""
        points_px = np.where(hidden[..., None], np.nan, self.points_px)
        return replace(self, points_px=read_only(points_px)).subset(_is_seen(points_px).sum(-1) >= 2)


def choose_sightings(
    poses: Iterable[Poses3D], joints: JointSet, timebase: Timebase, max_points: int = MAX_POINTS
) -> JointSightings:
    """Choose joints of people all over the take and the volume.

    Every square of 0.5 m of the floor gives equally many poses, evenly spread over time, as far as it has as many.
    Views with a score below 0.3 are left out, and fingers. The poses are like the ones from ``sampled_poses``;
    ``max_points`` is about the largest number of points.
    """
    index = [number for number, name in enumerate(joints.names) if name not in FINGER_JOINTS]
    parts = [_usable(some, index) for some in poses]
    if sum(len(frame) for frame, _, _ in parts) == 0:
        num_cameras = parts[0][2].shape[2] if parts else 0
        none = np.empty(0, np.int64)
        return JointSightings(np.empty(0), np.empty((0, num_cameras, 2)), none, none)
    frame, cell, points_px = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(frame, kind="stable")
    chosen = order[_spread(cell[order], max_points // len(index))]
    is_point = _is_seen(points_px[chosen]).sum(-1) >= 2
    time_s = timebase.start_time_s + frame[chosen] / timebase.frame_rate_hz
    square = np.unique(cell[chosen], axis=0, return_inverse=True)[1].reshape(-1)
    return JointSightings(
        read_only(np.repeat(time_s, is_point.sum(-1))),
        read_only(np.ascontiguousarray(points_px[chosen][is_point])),
        read_only(np.nonzero(is_point)[1]),
        read_only(np.repeat(square, is_point.sum(-1))),
    )


def sampled_frames(timebase: Timebase) -> range:
    """Frames 0.1 s apart, closer in takes of less than five seconds.

    The errors of consecutive detections are nearly equal.
    """
    step = min(round(_STEP_S * timebase.frame_rate_hz), timebase.num_frames // _MIN_INSTANTS)
    return range(0, timebase.num_frames, max(1, step))


def sampled_poses(people: People, timebase: Timebase) -> Iterator[Poses3D]:
    """Poses of each track at the frames of ``sampled_frames``."""
    step = sampled_frames(timebase).step
    for track, observed in zip(people.tracks, people.observations, strict=True):
        rows = np.arange(-track.start_frame % step, track.num_frames, step)
        yield Poses3D(
            frame=track.start_frame + rows,
            xyz_m=track.xyz_m[rows],
            points_px=observed.points_px[rows].swapaxes(1, 2),
            score=observed.score[rows].swapaxes(1, 2),
        )


def _is_seen(points_px: Float[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
    return np.isfinite(points_px).all(-1)


def _usable(
    poses: Poses3D, index: list[int]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, "n 2"], Float[np.ndarray, "n joints cameras 2"]]:
    """Frames, squares of the floor and views of the poses with a joint that two cameras see."""
    points_px = np.where(poses.score[:, index, :, None] >= _MIN_SCORE, poses.points_px[:, index], np.nan)
    xy_m = poses.xyz_m[:, index, :2]
    is_known = np.isfinite(xy_m).all(-1)
    kept = (_is_seen(points_px).sum(-1) >= 2).any(-1) & is_known.any(-1)
    total_m = np.where(is_known[kept, :, None], xy_m[kept], 0.0).sum(1)
    cell = np.floor(total_m / is_known[kept].sum(-1)[:, None] / _CELL_M).astype(np.int64)
    return poses.frame[kept], cell, points_px[kept]


def _spread(cells: Int[np.ndarray, "n 2"], budget: int) -> Int[np.ndarray, " chosen"]:
    """Choose rows: the same number from each cell, evenly spread, as far as the cell has as many."""
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    counts = np.bincount(cell)
    limit = next((k for k in range(counts.max(), 1, -1) if np.minimum(counts, k).sum() <= budget), 1)
    rows = []
    for number, count in enumerate(counts):
        of_cell = np.flatnonzero(cell == number)
        kept = min(int(count), limit)
        rows.append(of_cell[np.arange(kept) * count // kept])
    return np.sort(np.concatenate(rows))
