"""Remaining error of declared times: by how much cameras that should be synchronised are not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.data import Camera, Detections, FrameTimes
from pipeline.joints import JointSet
from pipeline.synchronization.synchronize import synchronize


@dataclass(frozen=True, slots=True)
class RemainingOffset:
    """Error of a camera's declared times.

    Parameters
    ----------
    camera
        Name of the camera.
    late_s
        Time by which the camera's frames were taken later than declared, compared with the median camera.
    sigma_s
        Standard deviation.
    frames
        ``late_s`` in periods of the camera's frames.
    """

    camera: str
    late_s: float
    sigma_s: float
    frames: float

    @property
    def is_wrong(self) -> bool:
        """Whether the declared times are wrong by more than half a frame, and the measurement can tell."""
        return abs(self.frames) > 0.5 and abs(self.late_s) > 3.0 * self.sigma_s


def remaining_offsets(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
) -> tuple[RemainingOffset, ...]:
    """Measure the error of declared times from people in motion, for checks before or after a take.

    Parameters
    ----------
    cameras
        Calibrated cameras.
    times, detections
        Declared frame times and bodies by camera name, such as of ``pipeline.stages.local.detect_people`` or of
        ``KeypointSession``. A few seconds in which people move are enough; a take of five minutes costs half a minute.
    joints
        Joints of the detections.

    Returns
    -------
        One for each camera, in their order; empty if the clocks can't be measured with certainty, as when nobody moves.

    Examples
    --------
    ``[one for one in remaining_offsets(...) if one.is_wrong]`` are the cameras to warn of.
    """
    found = synchronize(cameras, times, detections, joints, dict.fromkeys(times, 0.0)).synchronization
    if not found.is_certain:
        return ()
    late_s = []
    for clock in found.clocks:
        middle_s = times[clock.camera].time_s[[0, -1]].mean(keepdims=True)
        late_s.append(float(clock.session_s(middle_s)[0] - middle_s[0]))
    median_s = float(np.median(late_s))
    return tuple(
        RemainingOffset(
            clock.camera,
            value_s - median_s,
            clock.sigma_s,
            (value_s - median_s) / float(np.median(np.diff(times[clock.camera].time_s))),
        )
        for clock, value_s in zip(found.clocks, late_s, strict=True)
    )
