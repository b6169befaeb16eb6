"""Offsets of the cameras' clocks, from the people of a capture's first seconds."""

from collections.abc import Sequence
from concurrent.futures import Executor, Future

import numpy as np

from pipeline.capture.synchronization.synchronize import synchronize
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import STREAM_SILENT
from pipeline.detection.bodies import boxes_around
from pipeline.run.live.records import DetectedFrame

# Fewer frames of a camera show no motion.
_MIN_FRAMES = 10


class OffsetSearch:
    """Search for the offsets by the first seconds of a capture, in another process; what comes meanwhile is not used.

    ``seconds``: length of what is searched; ``None``: no search, all offsets are 0.
    """

    def __init__(self, cameras: Sequence[Camera], joints: JointSet, seconds: float | None) -> None:
        self._cameras, self._joints, self._seconds = cameras, joints, seconds
        self._found: Future[list[float]] | None = None
        self.frames: list[DetectedFrame] = []
        self.offsets_s: list[float] | None = [0.0] * len(cameras) if seconds is None else None
        """Offsets in the cameras' order; ``None`` until they are found."""

    def add(self, frame: DetectedFrame) -> None:
        """Take a frame of the first seconds; later ones are ignored."""
        if self._found is None:
            self.frames.append(frame)

    def advance(self, time_s: float, pool: Executor) -> bool:
        """Begin the search when its time has come; return whether it has found the offsets now.

        Raises ``InputError`` as ``find_offsets``.
        """
        if self.offsets_s is None and self._seconds is not None and self._found is None and time_s >= self._seconds:
            self._found = pool.submit(find_offsets, self._cameras, self.frames, self._joints)
        if self.offsets_s is not None or self._found is None or not self._found.done():
            return False
        self.offsets_s = self._found.result()
        return True

    def moved(self, frame: DetectedFrame) -> DetectedFrame:
        """Frame at its time on the common clock."""
        offset_s = 0.0 if self.offsets_s is None else self.offsets_s[frame.camera]
        return frame._replace(time_s=frame.time_s + offset_s)


def find_offsets(cameras: Sequence[Camera], frames: Sequence[DetectedFrame], joints: JointSet) -> list[float]:
    """Measure what is to be added to the times of each camera, so that all show the same at the same time.

    ``frames``: frames of all cameras, of each camera in the order of their times; some seconds, less than half a
    minute. Returns offsets in seconds, in the cameras' order. Raises ``InputError`` if a camera has too few frames, or
    the offsets are not certain: a motion from wrong times would look plausible.
    """
    times, detections, problems = {}, {}, []
    for number, camera in enumerate(cameras):
        own = [frame for frame in frames if frame.camera == number]
        if len(own) < _MIN_FRAMES:
            message = "Too few pictures of the camera were detected to find its offset."
            problems.append(Problem(STREAM_SILENT, message, camera=camera.name, hint="See that it is on."))
        times[camera.name] = FrameTimes(read_only(np.array([frame.time_s for frame in own])))
        detections[camera.name] = _stacked(camera.name, own, len(joints.names))
    if problems:
        raise InputError(problems)
    starts_s = dict.fromkeys(times, 0.0)
    found = synchronize(cameras, times, detections, joints, starts_s)
    if found.refusals:
        raise InputError(found.refusals)
    return [clock.shift_s for clock in found.clocks]


def _stacked(camera: str, frames: Sequence[DetectedFrame], num_joints: int) -> Detections:
    number = np.repeat(np.arange(len(frames)), [len(frame.score) for frame in frames])
    keypoints_px = np.concatenate([np.empty((0, num_joints, 2)), *(frame.points_px for frame in frames)])
    score = np.concatenate([np.empty((0, num_joints)), *(frame.score for frame in frames)])
    return Detections(camera, number, keypoints_px, score, boxes_around(keypoints_px))
