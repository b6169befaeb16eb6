"""Tracks of a live capture to which recorded detections are played, to be scored as those of a finished session."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.core.data.cameras import Camera, FrameTimes, Timebase
from pipeline.core.data.detections import Detections
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.records import recorded_frames
from pipeline.run.live.settings import LiveSettings
from pipeline.validation.evaluation.incremental import unscored_track


def live_tracks(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    timebase: Timebase,
    joints: JointSet,
) -> tuple[Track3D, ...]:
    """Play detections to a live capture; return what it says of each person, NaN where it says nothing."""
    capture = LiveCapture(cameras, joints, LiveSettings(timebase.frame_rate_hz))
    instants = [instant for frame in recorded_frames(cameras, times, detections) for instant in capture.push(*frame)]
    instants += capture.flush()
    said: dict[int, dict[int, Float[np.ndarray, "joints 3"]]] = defaultdict(dict)
    for instant in instants:
        frame = round((instant.time_s - timebase.start_time_s) * timebase.frame_rate_hz)
        for person in instant.people:
            said[person.id][frame] = person.xyz_m
    return tuple(_track(number, xyz_m) for number, xyz_m in sorted(said.items()))


def _track(number: int, said: Mapping[int, Float[np.ndarray, "joints 3"]]) -> Track3D:
    first, last = min(said), max(said)
    num_joints = len(said[first])
    xyz_m = np.full((last - first + 1, num_joints, 3), np.nan)
    for frame, joints_m in said.items():
        xyz_m[frame - first] = joints_m
    return unscored_track(number, xyz_m, first)
