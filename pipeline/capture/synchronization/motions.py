"""Motions: joints of bodies that one camera follows, smoothed and sampled on an even grid of the camera's own time.

Sampling at any instant between frames must not change the noise, or offsets of half a frame look best: two averaged
frames have less noise than one. So a kernel smooths all cameras alike before anything is interpolated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.calibration.people.following import JOINTS, MAX_GAP_S, Followed, follow_bodies
from pipeline.capture.synchronization.motion_kernels import fit_local_lines
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.geometry.undistortion import undistort_px

STEP_S = 0.02
"""Step of the grid; grid point ``k`` is at ``k * STEP_S``."""

MIN_POINTS = 10
"""Grid points of the shortest motion."""

FOLLOWED = (*JOINTS, "left_heel", "right_heel", "left_big_toe", "right_big_toe")
"""Joints of a motion, as far as the detector finds them."""

# Standard deviation of the smoothing kernel: at least so long, and so many periods of the slowest camera.
_KERNEL_S, _KERNEL_PERIODS = 0.03, 0.8
_KERNEL_REACH = 2.5
# Longer takes are read in blocks of time that are so long together, a block each.
_LONGEST_S, _BLOCK_S = 330.0, 22.0
# Error up to which a joint fits, as a share of the body's height in the image, and in pixels at least.
_TOLERANCE, _MIN_TOLERANCE_PX = 0.05, 4.0


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """Joints of one body in one camera."""

    camera: int  # Number of the camera
    first: int  # First grid point, on the camera's own time
    # Joints on the normalised image plane (z = 1), without distortion; NaN where a joint is not seen
    points: Float[np.ndarray, "steps joints 2"]
    speed: Float[np.ndarray, "steps joints 2"]  # Their change in a second
    tolerance: float  # Error of a joint up to which it fits, on the normalised image plane
    path: Float[np.ndarray, "steps joints"]  # Path of each joint during a grid step, in tolerances; NaN where not seen

    @property
    def stop(self) -> int:
        """Grid point after the last one."""
        return self.first + len(self.points)


def find_motions(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections], joints: JointSet
) -> list[BodyMotion]:
    """Follow bodies through each camera's frames, and sample them; no motions if no camera has two frames."""
    periods_s = [
        float(np.median(np.diff(frame_times.time_s))) for frame_times in times.values() if len(frame_times.time_s) > 1
    ]
    kernel_s = max(_KERNEL_S, _KERNEL_PERIODS * max(periods_s, default=0.0))
    return [
        motion
        for number, camera in enumerate(cameras)
        for body in follow_bodies(times[camera.name].time_s, detections[camera.name], joints, FOLLOWED)
        if (motion := _sampled(number, camera, body, kernel_s)) is not None
    ]


def _sampled(number: int, camera: Camera, body: Followed, kernel_s: float) -> BodyMotion | None:
    """Smooth a body by local lines (Cleveland 1979) with a Gaussian kernel; ``None`` if it is too short."""
    first = int(np.ceil(body.times_s[0] / STEP_S - 1e-6))
    stop = int(np.floor(body.times_s[-1] / STEP_S + 1e-6)) + 1
    if stop - first < MIN_POINTS or len(body.times_s) < 3:
        return None
    points = _ideal(camera, body.points_px)
    value, slope = _local_lines(body.times_s, points, STEP_S * np.arange(first, stop), kernel_s)
    tolerance = max(_TOLERANCE * body.height_px, _MIN_TOLERANCE_PX) / float(camera.matrix[0, 0])
    path = read_only(np.linalg.norm(slope, axis=-1) * STEP_S / tolerance)
    return BodyMotion(number, first, read_only(value), read_only(slope), tolerance, path)


def _ideal(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    inverse = np.linalg.inv(camera.matrix)
    return undistort_px(camera, points_px) @ inverse[:2, :2].T + inverse[:2, 2]


def _local_lines(
    times_s: Float[np.ndarray, " frames"],
    points: Float[np.ndarray, "frames joints 2"],
    wanted_s: Float[np.ndarray, " steps"],
    kernel_s: float,
) -> tuple[Float[np.ndarray, "steps joints 2"], Float[np.ndarray, "steps joints 2"]]:
    """Values and slopes of lines that are fitted around each wanted time; NaN in gaps and beyond the frames."""
    period_s = float(np.median(np.diff(times_s)))
    reach = int(np.ceil(_KERNEL_REACH * kernel_s / period_s)) + 1
    # A joint must be seen near by, before and after.
    limit_s = min(MAX_GAP_S, 1.5 * period_s + kernel_s)
    value, slope = np.empty((2, len(wanted_s), *points.shape[1:]))
    fit_local_lines(times_s, points, wanted_s, kernel_s, reach, limit_s, np.empty(2 * reach), value, slope)
    return value, slope


def excerpt(times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]) -> dict[str, Detections]:
    """Detections in blocks of time all over a long take; all of them in takes of up to five minutes."""
    begin_s = min(float(frame_times.time_s[0]) for frame_times in times.values())
    end_s = max(float(frame_times.time_s[-1]) for frame_times in times.values())
    if end_s - begin_s <= _LONGEST_S:
        return dict(detections)
    num_blocks = int(_LONGEST_S / _BLOCK_S)
    period_s = (end_s - begin_s) / num_blocks
    return {
        name: bodies.select((times[name].time_s[bodies.frame] - begin_s) % period_s < _BLOCK_S)
        for name, bodies in detections.items()
    }
