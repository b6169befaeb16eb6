"""Synchronisation of a session: clocks measured from its people, and the session on these clocks."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from math import isfinite

import numpy as np
from jaxtyping import Float32

from pipeline.capture.session import Session
from pipeline.capture.synchronization.declared import synchronize_declared
from pipeline.capture.synchronization.motions import excerpt
from pipeline.capture.synchronization.sound.offsets import SoundOffsets, sound_offsets
from pipeline.capture.synchronization.synchronize import corrected_times
from pipeline.core.data.cameras import Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError
from pipeline.core.findings import Finding, from_problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.findings import CLOCK_MEASURED
from pipeline.core.progress import OnShare, ignore
from pipeline.video.sound import listen_in_child
from pipeline.video.timeline import session_timebase

# Largest difference of the rates of a video's own times and of the session's, as a share.
_SAME_RATE = 1e-3


def measure_clocks(
    session: Session,
    detections: Mapping[str, Detections],
    joints: JointSet,
    sound: SoundOffsets = SoundOffsets(),  # noqa: B008 - frozen
    on_share: OnShare = ignore,
) -> Synchronization:
    """Measure the clocks of a session's cameras, from motion with the help of sound and of declared offsets.

    Raises ``InputError`` if the clocks are not certain: a motion from wrong times would look plausible.
    """
    bodies = excerpt(session.times, detections)
    clocks = synchronize_declared(
        session.cameras, session.times, bodies, joints, session.starts_s, sound, session.offset_std_s, on_share
    )
    if clocks.refusals:
        raise InputError(clocks.refusals)
    return clocks


def listen(session: Session, reading: Callable[[str], AbstractContextManager[None]]) -> SoundOffsets:
    """Offsets from the sound of a session's videos; none without videos.

    ``reading`` gives the block in which the video of a camera can be read, by the camera's name.
    """
    sounds: dict[str, Float32[np.ndarray, " ms"] | str] = {}
    for camera, video in session.video_of.items():
        declared_s = session.times[camera].time_s[[0, -1]]
        if abs((declared_s[1] - declared_s[0]) / max(float(video.time_s[-1]), 1e-9) - 1.0) > _SAME_RATE:
            sounds[camera] = "The frame rate was stated: the sound has other times."
            continue
        with reading(camera):
            sounds[camera] = listen_in_child(video)
    return sound_offsets(session.cameras, sounds)


def on_measured_clocks(session: Session, synchronization: Synchronization) -> Session:
    """Session with its frames at the measured times.

    The output frames keep their times and their rate; there are more of them if a camera recorded for longer than was
    declared.
    """
    times = corrected_times(session.times, synchronization)
    declared, measured = session.timebase, session_timebase(times)
    end_s = measured.time_s(measured.num_frames - 1)
    num_frames = round((end_s - declared.start_time_s) * declared.frame_rate_hz) + 1
    timebase = replace(declared, num_frames=max(declared.num_frames, num_frames))
    return session.at_times(times, timebase)


def clock_findings(synchronization: Synchronization) -> Iterator[Finding]:
    """Findings of a synchronisation: why the clocks are not certain, or what they are."""
    yield from map(from_problem, synchronization.refusals)
    yield from (replace(from_problem(warning), severity="warning") for warning in synchronization.warnings)
    for clock in synchronization.clocks if synchronization.is_certain else ():
        message = f"The camera's own time 0 is {clock.offset_s:+.4f} s of the session's time, as measured."
        hint = "Reconstruct with sync: auto, which measures the same, or declare this offset."
        evidence = {"offset_s": clock.offset_s, "sigma_s": clock.sigma_s, "rate": clock.rate}
        known = {name: value for name, value in evidence.items() if isfinite(value)}
        yield Finding(CLOCK_MEASURED, message, clock.camera, "info", hint, known)


def largest_shift_s(declared: Session, measured: Session) -> float:
    """Largest difference between a frame's declared and measured time."""
    return max(
        abs(float(times.time_s[place] - declared.times[name].time_s[place]))
        for name, times in measured.times.items()
        for place in (0, -1)
    )
