"""Simulated takes whose cameras started at different times."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.capture.synchronization.synchronize import synchronize
from pipeline.core.data.cameras import Camera, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.validation.simulation.motion.script import Gesture, Role, Stay
from pipeline.validation.simulation.scenes import Scene, find_scene, record


@dataclass(frozen=True)
class Take:
    """A take with each camera's own times, which begin at 0, and the true time of its first frame."""

    cameras: tuple[Camera, ...]
    times: Mapping[str, FrameTimes]
    detections: Mapping[str, Detections]
    joints: JointSet
    start_s: tuple[float, ...]

    def synchronized(self) -> Synchronization:
        """Measured clocks."""
        return synchronize(self.cameras, self.times, self.detections, self.joints, dict.fromkeys(self.times, 0.0))


def cut_take(scene: Scene, seed: int, first_frames: Sequence[int], stretch: Sequence[float] | None = None) -> Take:
    """Simulate a scene, and leave out the first frames of each camera.

    Parameters
    ----------
    stretch
        Rate of each camera's own clock.
    """
    simulation = record(scene, seed, len(first_frames))
    times, detections, start_s = {}, {}, []
    for number, (camera, first) in enumerate(zip(simulation.cameras, first_frames, strict=True)):
        true_s = simulation.times[camera.name].time_s[first:]
        found = simulation.detections[camera.name]
        kept = found.frame >= first
        detections[camera.name] = replace(
            found,
            frame=found.frame[kept] - first,
            keypoints_px=found.keypoints_px[kept],
            score=found.score[kept],
            box_px=found.box_px[kept],
        )
        times[camera.name] = FrameTimes((true_s - true_s[0]) * (1.0 if stretch is None else stretch[number]))
        start_s.append(float(true_s[0]))
    return Take(simulation.cameras, times, detections, simulation.joints, tuple(np.array(start_s) - min(start_s)))


def shortened(name: str, duration_s: float) -> Scene:
    """Named scene of another length."""
    return replace(find_scene(name), duration_s=duration_s)


def alone(gesture: Gesture, duration_s: float = 8.0) -> Scene:
    """One person in a room who stands and makes one gesture."""
    return replace(find_scene("room"), cast=(Role((0.0, 0.0), 0.0, (Stay(60.0, gesture),)),), duration_s=duration_s)
