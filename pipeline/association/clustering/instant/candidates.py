"""2D evidence of all cameras: candidates of joints at an instant, and what connects them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from pipeline.association.clustering.clustering_parameters import ClusteringParameters
from pipeline.association.clustering.instant.evidence import (
    NOWHERE,
    AffinityFields,
    LimbEvidence,
    Membership,
    ViewFields,
)
from pipeline.association.clustering.instant.hypotheses import Candidates
from pipeline.association.clustering.skeleton import Skeleton
from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections, PafFields
from pipeline.geometry.undistortion import undistort_px


class Instant(NamedTuple):
    """Candidates at an output frame, and the evidence that connects them."""

    candidates: Candidates
    evidence: LimbEvidence


@runtime_checkable
class ViewEvidence(Protocol):
    """2D evidence of all cameras over time."""

    def at(self, frame: int) -> Instant:
        """Evidence for an output frame from each camera's nearest frame within half a period, if there is one."""


def frame_at(times: FrameTimes, timebase: Timebase, frame: int) -> int | None:
    """Number of a camera's frame nearest to an output frame, within the output frame's half-open period.

    Periods cut time in the same way as chunks of frames, so that all evidence for an output frame is in its chunk.
    ``None`` if the camera has no frame in the period.
    """
    first, stop = np.searchsorted(times.time_s, [timebase.time_s(frame - 0.5), timebase.time_s(frame + 0.5)])
    if first == stop:
        return None
    return int(first + np.abs(times.time_s[first:stop] - timebase.time_s(frame)).argmin())


class BodyEvidence:
    """Evidence from a detector's bodies: their joints are candidates, and joints of a body are connected.

    Cameras are in the order of ``Candidates.view``; frame times and detections are by camera name.
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
        self._frame = [of_camera.frame for of_camera in ordered]
        self._timebase, self._min_score = timebase, parameters.min_score
        self._seen_px = [_in_order(of_camera.keypoints_px, skeleton) for of_camera in ordered]
        self._cameras = cameras
        self._score = [_scores_in_order(of_camera, skeleton) for of_camera in ordered]
        self._evidence = Membership(skeleton, parameters.tau2)

    def at(self, frame: int) -> Instant:
        """Evidence for an output frame; ``body`` is the row among the camera's detections. See ``ViewEvidence``."""
        views = []
        for view, times in enumerate(self._times):
            nearest = frame_at(times, self._timebase, frame)
            if nearest is not None:
                start, stop = np.searchsorted(self._frame[view], [nearest, nearest + 1])
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
    """Evidence from heatmaps and fields: peaks are candidates, and part affinity fields connect them.

    Cameras are in the order of ``Candidates.view``; frame times and fields are by camera name. The fields must cover
    the output frames given to ``at``.
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
        (self._limbs,) = {of_camera.limbs.tobytes(): of_camera.limbs for of_camera in self._fields}.values()

    def at(self, frame: int) -> Instant:
        """Evidence for an output frame; see ``ViewEvidence``."""
        views, shown = [], []
        for view, (camera, of_camera) in enumerate(zip(self._cameras, self._fields, strict=True)):
            nearest = frame_at(self._times[view], self._timebase, frame)
            row = NOWHERE if nearest is None else int(np.searchsorted(of_camera.frame, nearest))
            if 0 <= row < len(of_camera.frame) and of_camera.frame[row] == nearest:
                views.append(self._candidates(view, row))
                shown.append(ViewFields(camera, of_camera.fields[row], of_camera.grid))
        return Instant(_join(views), AffinityFields(shown, self._limbs, self._skeleton, self._parameters.tau2))

    def _candidates(self, view: int, row: int) -> Candidates:
        fields = self._fields[view]
        peaks = slice(*np.searchsorted(fields.peak_row, [row, row + 1]))
        # Peaks of joints that the skeleton lacks get the joint NOWHERE, and are left out.
        joint_of = np.full(max(*self._skeleton.sources, *fields.peak_joint[peaks], 0) + 1, NOWHERE)
        joint_of[list(self._skeleton.sources)] = np.arange(len(self._skeleton.sources))
        joint = joint_of[fields.peak_joint[peaks]]
        candidates = Candidates(
            joint=joint,
            view=np.full(len(joint), view),
            points_px=_undistorted(self._cameras[view], fields.peak_px[peaks]),
            seen_px=fields.peak_px[peaks],
            score=fields.peak_score[peaks],
            body=np.full(len(joint), NOWHERE),
        )
        return candidates.where((joint >= 0) & (candidates.score >= self._parameters.min_score))


def _undistorted(camera: Camera, seen_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Undistort the points of a single frame.

    Points that are undistorted together iterate together, so that their last bits depend on each other. A frame at a
    time, results do not depend on the cut of the session into chunks.
    """
    return undistort_px(camera, seen_px)


def _join(views: Sequence[Candidates]) -> Candidates:
    nothing = Candidates(
        np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0, int)
    )
    return Candidates(*(np.concatenate(values) for values in zip(nothing, *views, strict=True)))


def _in_order(keypoints_px: Float[np.ndarray, "n joints 2"], skeleton: Skeleton) -> Float[np.ndarray, "n _ 2"]:
    """Joints in the skeleton's order; the neck is the midpoint of the shoulders if the detector has none."""
    ordered = keypoints_px[:, skeleton.sources]
    if skeleton.sources[0] < 0:
        ordered[:, 0] = ordered[:, skeleton.shoulders].mean(1)
    return ordered


def _scores_in_order(detections: Detections, skeleton: Skeleton) -> Float[np.ndarray, "n _"]:
    ordered = detections.score[:, skeleton.sources]
    if skeleton.sources[0] < 0:
        ordered[:, 0] = ordered[:, skeleton.shoulders].min(1)
    return ordered
