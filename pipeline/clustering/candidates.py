"""What all cameras saw, in the skeleton's order; and which of it shows an instant."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.clustering.hypotheses import Candidates
from pipeline.clustering.skeleton import Skeleton
from pipeline.data import Camera, Detections, FrameTimes
from pipeline.geometry.undistortion import undistort_px


class Seen:
    """The candidates of every joint, from whole bodies that a detector found.

    Parameters
    ----------
    cameras
        Their order is that of views.
    times, detections
        By camera name.
    skeleton
        Which joints, and where the detector has them.
    min_score
        Joints below are no candidates.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        times: Mapping[str, FrameTimes],
        detections: Mapping[str, Detections],
        skeleton: Skeleton,
        min_score: float,
    ) -> None:
        ordered = [detections[camera.name] for camera in cameras]
        self._time_s = [times[camera.name].time_s for camera in cameras]
        self._frame = [one.frame for one in ordered]
        self._min_score = min_score
        self.seen_px = [_in_order(one.keypoints_px, skeleton) for one in ordered]
        self._ideal_px = [undistort_px(camera, px) for camera, px in zip(cameras, self.seen_px, strict=True)]
        self.score = [_scores_in_order(one, skeleton) for one in ordered]

    def at(self, time_s: float, half_s: float) -> Candidates:
        """Candidates in the frames nearest to an instant, no farther than ``half_s``.

        A candidate's body is the row of its detection among its camera's.
        """
        rows = [self._rows(view, time_s, half_s) for view in range(len(self._frame))]
        view = np.repeat(np.arange(len(rows)), [len(mine) for mine in rows])
        body = np.concatenate(rows)
        points_px = np.concatenate([self._ideal_px[number][mine] for number, mine in enumerate(rows)])
        score = np.concatenate([self.score[number][mine] for number, mine in enumerate(rows)])
        found = (score >= self._min_score) & (score > 0) & np.isfinite(points_px).all(-1)
        number, joint = np.nonzero(found)
        return Candidates(joint, view[number], points_px[found], score[found], body[number])

    def _rows(self, view: int, time_s: float, half_s: float) -> Int[np.ndarray, " _"]:
        """A camera's detections in the frame nearest to an instant."""
        frames_s = self._time_s[view]
        after = int(np.searchsorted(frames_s, time_s))
        near = [frame for frame in (after - 1, after) if 0 <= frame < len(frames_s)]
        nearest = min(near, key=lambda frame: abs(frames_s[frame] - time_s), default=None)
        if nearest is None or abs(frames_s[nearest] - time_s) > half_s:
            return np.empty(0, int)
        start, stop = np.searchsorted(self._frame[view], [nearest, nearest + 1])
        return np.arange(start, stop)


def _in_order(keypoints_px: Float[np.ndarray, "n joints 2"], skeleton: Skeleton) -> Float[np.ndarray, "n _ 2"]:
    """Joints as the skeleton has them; a neck that the detector does not know is its shoulders' middle."""
    ordered = keypoints_px[:, skeleton.sources]
    if skeleton.sources[0] < 0:
        ordered[:, 0] = ordered[:, skeleton.shoulders].mean(1)
    return ordered


def _scores_in_order(one: Detections, skeleton: Skeleton) -> Float[np.ndarray, "n _"]:
    ordered = one.score[:, skeleton.sources]
    if skeleton.sources[0] < 0:
        ordered[:, 0] = ordered[:, skeleton.shoulders].min(1)
    return ordered
