"""What all cameras saw, in the skeleton's order; and which of it shows an instant."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from pipeline.clustering.instant.evidence import NOWHERE, AffinityFields, Evidence, Membership, ViewFields
from pipeline.clustering.instant.hypotheses import Candidates
from pipeline.clustering.parameters import ClusteringParameters
from pipeline.clustering.skeleton import Skeleton
from pipeline.data import Camera, Detections, FrameTimes, PafFields, Timebase
from pipeline.geometry.undistortion import undistort_px


class Instant(NamedTuple):
    """What there is to find people from at an output frame."""

    candidates: Candidates
    evidence: Evidence


@runtime_checkable
class ViewEvidence(Protocol):
    """What cameras saw over time."""

    def at(self, frame: int) -> Instant:
        """What shows an output frame: each camera's nearest frame within half a period, if it has one."""


def frame_at(times: FrameTimes, timebase: Timebase, frame: int) -> int | None:
    """A camera's frame nearest to an output frame, among those in its half-open period.

    Periods cut time as chunks of the map do, so that what shows an output frame lies in its chunk.
    """
    first, stop = np.searchsorted(times.time_s, [timebase.time_s(frame - 0.5), timebase.time_s(frame + 0.5)])
    if first == stop:
        return None
    return int(first + np.abs(times.time_s[first:stop] - timebase.time_s(frame)).argmin())


class BodyEvidence:
    """Candidates of whole bodies that a detector found; those of one body are connected.

    Parameters
    ----------
    cameras
        Their order is that of views.
    times, detections
        By camera name.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        times: Mapping[str, FrameTimes],
        detections: Mapping[str, Detections],
        timebase: Timebase,
        skeleton: Skeleton,
        parameters: ClusteringParameters,
    ) -> None:
        ordered = [detections[camera.name] for camera in cameras]
        self._times = [times[camera.name] for camera in cameras]
        self._frame = [one.frame for one in ordered]
        self._timebase, self._min_score = timebase, parameters.min_score
        self._seen_px = [_in_order(one.keypoints_px, skeleton) for one in ordered]
        self._cameras = cameras
        self._score = [_scores_in_order(one, skeleton) for one in ordered]
        self._evidence = Membership(skeleton, parameters.tau2)

    def at(self, frame: int) -> Instant:
        """Candidates, whose body is the row of its detection among its camera's; see ``ViewEvidence``."""
        views = []
        for view, times in enumerate(self._times):
            mine = frame_at(times, self._timebase, frame)
            if mine is not None:
                start, stop = np.searchsorted(self._frame[view], [mine, mine + 1])
                views.append(self._candidates(view, np.arange(start, stop)))
        return Instant(_join(views), self._evidence)

    def _candidates(self, view: int, rows: np.ndarray) -> Candidates:
        score, seen_px = self._score[view][rows], self._seen_px[view][rows]
        ideal_px = _undistorted(self._cameras[view], seen_px)
        number, joint = np.nonzero((score >= self._min_score) & (score > 0) & np.isfinite(ideal_px).all(-1))
        return Candidates(
            joint=joint,
            view=np.full(len(joint), view),
            points_px=ideal_px[number, joint],
            seen_px=seen_px[number, joint],
            score=score[number, joint],
            body=rows[number],
        )


class FieldEvidence:
    """Candidates from peaks of heatmaps; part affinity fields connect them.

    Parameters
    ----------
    cameras
        Their order is that of views.
    times, fields
        By camera name; of the fields those that show the output frames that are asked for.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        times: Mapping[str, FrameTimes],
        fields: Mapping[str, PafFields],
        timebase: Timebase,
        skeleton: Skeleton,
        parameters: ClusteringParameters,
    ) -> None:
        self._cameras, self._timebase, self._skeleton, self._parameters = cameras, timebase, skeleton, parameters
        self._times = [times[camera.name] for camera in cameras]
        self._fields = [fields[camera.name] for camera in cameras]
        (self._limbs,) = {one.limbs.tobytes(): one.limbs for one in self._fields}.values()

    def at(self, frame: int) -> Instant:
        """Candidates and fields; see ``ViewEvidence``."""
        views, shown = [], []
        for view, (camera, one) in enumerate(zip(self._cameras, self._fields, strict=True)):
            mine = frame_at(self._times[view], self._timebase, frame)
            row = NOWHERE if mine is None else int(np.searchsorted(one.frame, mine))
            if 0 <= row < len(one.frame) and one.frame[row] == mine:
                views.append(self._candidates(view, row))
                shown.append(ViewFields(camera, one.fields[row], one.grid))
        return Instant(_join(views), AffinityFields(shown, self._limbs, self._skeleton, self._parameters.tau2))

    def _candidates(self, view: int, row: int) -> Candidates:
        one = self._fields[view]
        peaks = slice(*np.searchsorted(one.peak_row, [row, row + 1]))
        # A joint of the detector that the skeleton lacks is the joint "nowhere", and so nobody's.
        joint_of = np.full(max(*self._skeleton.sources, *one.peak_joint[peaks], 0) + 1, NOWHERE)
        joint_of[list(self._skeleton.sources)] = np.arange(len(self._skeleton.sources))
        joint = joint_of[one.peak_joint[peaks]]
        found = Candidates(
            joint=joint,
            view=np.full(len(joint), view),
            points_px=_undistorted(self._cameras[view], one.peak_px[peaks]),
            seen_px=one.peak_px[peaks],
            score=one.peak_score[peaks],
            body=np.full(len(joint), NOWHERE),
        )
        return found.where((joint >= 0) & (found.score >= self._parameters.min_score))


def _undistorted(camera: Camera, seen_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Points of one frame in undistorted pixels.

    A frame at a time: points that are undistorted together end together, so their last bits depend on each other, and
    they must not depend on where the session was cut.
    """
    return undistort_px(camera, seen_px)


def _join(views: Sequence[Candidates]) -> Candidates:
    nothing = Candidates(
        np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0, int)
    )
    return Candidates(*(np.concatenate(values) for values in zip(nothing, *views, strict=True)))


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
