"""Records of a live capture: frames of cameras, also of a recorded session, instants, people and their skeletons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.core.data.detections import Detections


@dataclass(frozen=True, slots=True, eq=False)
class LiveSkeleton:
    """Pose of a person's animation skeleton at an instant; joints are in the order of ``skeleton.model:SKELETON``."""

    root_m: Float[np.ndarray, " 3"]  # World position of the root
    parent_from_joint: Float[np.ndarray, "bones 4"]  # Quaternions (x, y, z, w); the root's parent is the world, Z up
    bone_length_m: Float[np.ndarray, " bones"]  # Length of the bone from a joint's parent to the joint; 0 for the root
    joint_m: Float[np.ndarray, "bones 3"]  # World positions of the skeleton's joints


@dataclass(frozen=True, slots=True, eq=False)
class LivePerson:
    """A person at an instant."""

    id: int  # Number of the person, from 1 in order of first appearance; the same for the whole capture
    # World positions of the detector's joints, NaN where unknown: of the skeleton, or located before there is one
    xyz_m: Float[np.ndarray, "joints 3"]
    # ``None`` until the person's bones are learnt, and behind a gap until hips and shoulders are located
    skeleton: LiveSkeleton | None


@dataclass(frozen=True, slots=True, eq=False)
class LiveInstant:
    """People at an output instant, final: no later frame changes them."""

    time_s: float  # Time of the instant on the cameras' clock
    people: tuple[LivePerson, ...]  # People in sight, in order of their numbers
    lag_s: float  # Time on the cameras' clock from the instant to the newest frame that had come when it became final


@dataclass(frozen=True, slots=True)
class LiveCounts:
    """Frames of a live capture so far."""

    taken: int = 0  # Frames that were used, late ones included
    late: int = 0  # Frames that came after a later frame, of any camera, and were sorted in
    dropped: int = 0  # Frames that came too late and were not used


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
    """Frames of all cameras in time order, empty ones included; at the same time in order of the cameras.

    Parameters
    ----------
    cameras
        Cameras in the order of their numbers.
    times, detections
        Frame times in seconds and detections of each camera, by camera name.

    Returns
    -------
    list of RecordedFrame
        Frames with points in distorted pixels, NaN with score 0 where a joint was not detected.

    Examples
    --------
    >>> import multicap
    >>> session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", frame_rate_hz=25.0)
    >>> frames = multicap.recorded_frames(session.cameras, session.times, session.detections)
    >>> frames[0].camera, frames[0].points_px.shape[1:]
    (0, (17, 2))
    """
    return [RecordedFrame(*frame[:-1]) for frame in detected_frames(cameras, times, detections)]


def detected_frames(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], detections: Mapping[str, Detections]
) -> list[DetectedFrame]:
    """Frames like ``recorded_frames``, with the colours that the detections have."""
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
