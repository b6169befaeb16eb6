"""Sightings: joints of people in several cameras, chosen all over the take and the volume."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.data import People, Timebase, read_only
from pipeline.joints import JointSet

MAX_POINTS = 4000
"""Largest number of points; more take longer and hardly move the cameras."""

# Marks of the head and the feet differ more between views than these joints.
_JOINTS = tuple(
    f"{side}_{kind}" for kind in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for side in ("left", "right")
)
_MIN_SCORE = 0.3
# Detections of consecutive frames have nearly equal errors.
_STEP_S = 0.1
_CELL_M = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Joints of people, each seen by at least two cameras at one instant.

    Parameters
    ----------
    time_s
        Time of each point on the session's clock.
    points_px
        Distorted pixels of the full image; NaN where a camera does not see the point.
    """

    time_s: Float[np.ndarray, " points"]
    points_px: Float[np.ndarray, "points cameras 2"]

    def __len__(self) -> int:
        return len(self.time_s)

    def subset(self, chosen: Bool[np.ndarray, " points"]) -> "Sightings":
        """Select points."""
        return Sightings(self.time_s[chosen], self.points_px[chosen])

    def without(self, hidden: Bool[np.ndarray, "points cameras"]) -> "Sightings":
        """Leave out views, and the points that fewer than two cameras see then."""
        points_px = np.where(hidden[..., None], np.nan, self.points_px)
        return Sightings(self.time_s, read_only(points_px)).subset(_is_seen(points_px).sum(-1) >= 2)


def choose_sightings(
    people: People, joints: JointSet, timebase: Timebase, max_points: int = MAX_POINTS
) -> Sightings:
    """Choose joints of people all over the take and the volume.

    Instants lie at least 0.1 s apart. Every square of 0.5 m of the floor gives equally many instants, evenly spread
    over time, as far as it has as many. Views with a score below 0.3 are left out, and fingers and faces.

    Parameters
    ----------
    joints
        Joints of the people.
    max_points
        Largest number of points, about.
    """
    index = joints.indices(tuple(name for name in _JOINTS if name in joints.names))
    step = max(1, round(_STEP_S * timebase.frame_rate_hz))
    instants = list(_instants(people, index, step))
    num_cameras = people.observations[0].points_px.shape[1] if len(people.observations) else 0
    if not instants:
        return Sightings(np.empty(0), np.empty((0, num_cameras, 2)))
    frames, cells, points_px = (np.concatenate(parts) for parts in zip(*instants, strict=True))
    order = np.argsort(frames, kind="stable")
    chosen = order[_spread(cells[order], max_points // len(index))]
    is_point = _is_seen(points_px[chosen]).sum(-1) >= 2
    time_s = timebase.start_time_s + frames[chosen] / timebase.frame_rate_hz
    return Sightings(
        read_only(np.repeat(time_s, is_point.sum(-1))), read_only(np.ascontiguousarray(points_px[chosen][is_point]))
    )


def _is_seen(points_px: Float[np.ndarray, "*batch 2"]) -> Bool[np.ndarray, "*batch"]:
    return np.isfinite(points_px).all(-1)


def _instants(
    people: People, index: list[int], step: int
) -> Iterator[
    tuple[Int[np.ndarray, " n"], Int[np.ndarray, "n 2"], Float[np.ndarray, "n joints cameras 2"]]
]:
    """Frames, squares of the floor and views of each person, at the frames that are multiples of the step."""
    for track, observed in zip(people.tracks, people.observations, strict=True):
        frames = np.arange(track.start_frame, track.start_frame + track.num_frames)
        points_px = observed.points_px[:, :, index]
        points_px = np.where(observed.score[:, :, index, None] >= _MIN_SCORE, points_px, np.nan).swapaxes(1, 2)
        is_point = _is_seen(points_px).sum(-1) >= 2
        xy_m = track.xyz_m[:, index, :2]
        is_known = np.isfinite(xy_m).all(-1)
        kept = np.flatnonzero((frames % step == 0) & is_point.any(-1) & is_known.any(-1))
        total_m = np.where(is_known[kept, :, None], xy_m[kept], 0.0).sum(1)
        cells = np.floor(total_m / is_known[kept].sum(-1)[:, None] / _CELL_M).astype(np.int64)
        yield frames[kept], cells, points_px[kept]


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
