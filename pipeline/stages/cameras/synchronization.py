"""Synchronisation of a session: clocks measured from its people, and the session on these clocks."""

from collections.abc import Mapping
from dataclasses import replace

from pipeline.capture.session import CaptureSession
from pipeline.data import Detections, Synchronization, Timebase
from pipeline.errors import InputError
from pipeline.joints import JointSet
from pipeline.progress import OnShare, ignore
from pipeline.stages.association import Session
from pipeline.synchronization.synchronize import corrected_times, synchronize
from pipeline.video.timeline import session_timebase


def measure_clocks(
    session: Session, detections: Mapping[str, Detections], joints: JointSet, on_share: OnShare = ignore
) -> Synchronization:
    """Measure the clocks of a session's cameras.

    Raises
    ------
    InputError
        If the clocks are not certain: a motion from wrong times would look plausible.
    """
    found = synchronize(session.cameras, session.times, detections, joints, session.starts_s, on_share).synchronization
    if found.refusals:
        raise InputError(found.refusals)
    return found


def on_measured_clocks(session: Session, synchronization: Synchronization) -> Session:
    """Session with its frames at the measured times.

    The output frames keep their times and their rate; there are more of them if a camera recorded for longer than was
    declared.
    """
    times = corrected_times(session.times, synchronization)
    declared, measured = session.timebase, session_timebase(times)
    end_s = measured.time_s(measured.num_frames - 1)
    num_frames = round((end_s - declared.start_time_s) * declared.frame_rate_hz) + 1
    timebase = Timebase(declared.start_time_s, declared.frame_rate_hz, max(declared.num_frames, num_frames))
    if isinstance(session, CaptureSession):
        return replace(session, times=times, whole_timebase=timebase)
    return replace(session, times=times, timebase=timebase)


def largest_shift_s(declared: Session, measured: Session) -> float:
    """Largest difference between a frame's declared and measured time."""
    return max(
        abs(float(times.time_s[place] - declared.times[name].time_s[place]))
        for name, times in measured.times.items()
        for place in (0, -1)
    )
