"""Remaining error of declared times: by how much cameras that should be synchronised are not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.capture.synchronization.synchronize import synchronize
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet

HALF_A_FRAME = 0.5
"""Error in frames above which a camera is wrong."""


@dataclass(frozen=True, slots=True)
class RemainingOffset:
    """Error of a camera's declared times."""

    camera: str  # Name of the camera
    # Time by which the camera's frames were taken later than declared, compared with the cameras that agree
    late_s: float
    sigma_s: float  # Standard deviation
    frames: float  # ``late_s`` in periods of the camera's frames

    @property
    def is_wrong(self) -> bool:
        """True if the declared times are wrong by more than half a frame, and the measurement can tell."""
        return abs(self.frames) > HALF_A_FRAME and abs(self.late_s) > 3.0 * self.sigma_s


def remaining_offsets(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
) -> tuple[RemainingOffset, ...]:
    """Measure the error of declared times from people in motion, for checks before or after a take.

    Parameters
    ----------
    times, detections
        Declared frame times and bodies by camera name, such as from ``pipeline.run.engine.local.detect_people`` or of
        ``KeypointSession``. A few seconds in which people move are enough; a take of five minutes costs half a minute.

    Returns
    -------
        One for each camera, in their order; empty if the clocks can't be measured with certainty, as when nobody moves.

    Examples
    --------
    ``[offset for offset in remaining_offsets(...) if offset.is_wrong]`` are the cameras to warn of.
    """
    synchronization = synchronize(cameras, times, detections, joints, dict.fromkeys(times, 0.0))
    if not synchronization.is_certain:
        return ()
    late_s = []
    for clock in synchronization.clocks:
        middle_s = times[clock.camera].time_s[[0, -1]].mean(keepdims=True)
        late_s.append(float(clock.session_s(middle_s)[0] - middle_s[0]))
    periods_s = [float(np.median(np.diff(times[clock.camera].time_s))) for clock in synchronization.clocks]
    agreed_s = _agreed_s(np.array(late_s), np.array(periods_s))
    return tuple(
        RemainingOffset(clock.camera, value_s - agreed_s, clock.sigma_s, (value_s - agreed_s) / period_s)
        for clock, value_s, period_s in zip(synchronization.clocks, late_s, periods_s, strict=True)
    )


def _agreed_s(late_s: Float[np.ndarray, " cameras"], periods_s: Float[np.ndarray, " cameras"]) -> float:
    """Lateness of the camera from which the fewest others differ by more than half a frame; the first of several.

    A mean of two cameras would be a quarter of a frame from each, where they are half a frame apart.
    """
    apart = np.abs(late_s[:, None] - late_s) / periods_s
    order = np.lexsort((apart.sum(1).round(6), (apart > HALF_A_FRAME).sum(1)))
    near = apart[order[0]] <= HALF_A_FRAME
    return float(np.median(late_s[near])) if near.sum() > 2 else float(late_s[order[0]])
