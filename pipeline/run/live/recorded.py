"""Frames of cameras, and those of a recorded session as cameras would send them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections


class RecordedFrame(NamedTuple):
    """A camera's frame, as the arguments of ``LiveCapture.push`` and of the service's clients."""

    camera: int  # Position of the camera
    time_s: float
    points_px: Float[np.ndarray, "people joints 2"]
    score: Float[np.ndarray, "people joints"]


class DetectedFrame(NamedTuple):
    """A camera's frame with the colours of the clothes, as the arguments of ``LiveCapture.push``."""

    camera: int  # Position of the camera
    time_s: float
    points_px: Float[np.ndarray, "people joints 2"]
    score: Float[np.ndarray, "people joints"]
    colour: UInt8[np.ndarray, "people parts bins"] | None  # ``None``: not measured


def recorded_frames(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]
) -> list[RecordedFrame]:
    """Frames of all cameras in time order, empty ones included; at the same time in order of the cameras."""
    return [RecordedFrame(*frame[:-1]) for frame in detected_frames(cameras, times, detections)]


def detected_frames(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]
) -> list[DetectedFrame]:
    """Frames as of ``recorded_frames``, with the colours that the detections have."""
    frames = []
    for number, camera in enumerate(cameras):
        of_camera = detections[camera.name]
        times_s = times[camera.name].time_s
        borders = np.searchsorted(of_camera.frame, np.arange(len(times_s) + 1)).tolist()
        for frame, time_s in enumerate(times_s.tolist()):
            rows = slice(borders[frame], borders[frame + 1])
            colour = of_camera.colour[rows] if len(of_camera.colour) else None
            frames.append(DetectedFrame(number, time_s, of_camera.keypoints_px[rows], of_camera.score[rows], colour))
    return sorted(frames, key=lambda frame: (frame.time_s, frame.camera))
