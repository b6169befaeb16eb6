"""Clocks of a session: measured from its people and its sound, within the stated uncertainty of declared offsets."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from math import isfinite

import numpy as np
from jaxtyping import Float32

from pipeline.capture.session import Session
from pipeline.capture.synchronization.clock_checks import precision_doubts
from pipeline.capture.synchronization.motions import excerpt
from pipeline.capture.synchronization.sound_offsets import SoundOffsets, sound_offsets, synchronize_with_sound
from pipeline.capture.synchronization.synchronize import (
    KNOWN_WITHIN_S,
    corrected_times,
    starting_as_declared,
    synchronize,
)
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError, Problem
from pipeline.core.findings import Finding, from_problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import CLOCK_MEASURED, SYNC_AS_DECLARED, SYNC_BEYOND_DECLARED
from pipeline.core.progress import OnShare, ignore
from pipeline.video.timeline import session_timebase

# Standard deviations by which a measured offset may differ from the declared one; and the difference that is always
# allowed: stated uncertainties of clocks leave out how a camera delays its pictures.
_MAX_SIGMAS, _ALWAYS_NEAR_S = 4.0, 0.02


def synchronize_declared(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    starts_s: Mapping[str, float],
    sound: SoundOffsets,
    declared_std_s: Mapping[str, float],
    on_share: OnShare = ignore,
) -> Synchronization:
    """Measure the cameras' clocks, starting from declared offsets with stated uncertainties.

    Of cameras with an uncertainty only offsets within it are compared. What motion tells beyond it is used with a
    warning, if it is certain without the declared offsets too. If motion tells nothing, and the declared offsets are
    fine enough, the clocks are as declared.

    ``declared_std_s``: standard deviation of the declared offset by camera; cameras without one are looked for over the
    whole take.
    """
    known = {name: std_s for name, std_s in declared_std_s.items() if _MAX_SIGMAS * std_s <= KNOWN_WITHIN_S}
    if len(known) < 2:
        return synchronize_with_sound(cameras, times, detections, joints, starts_s, sound, on_share)
    near = synchronize(cameras, times, detections, joints, starts_s, on_share, near_s=dict.fromkeys(known, 0.0))
    if near.is_certain and not beyond_declared(near.clocks, times, known):
        return near
    anywhere = synchronize_with_sound(cameras, times, detections, joints, starts_s, sound, on_share)
    if anywhere.is_certain:
        far = beyond_declared(anywhere.clocks, times, known)
        return replace(anywhere, warnings=(*anywhere.warnings, *(_beyond(name, far[name], known) for name in far)))
    if len(known) < len(cameras):
        return anywhere
    clocks = tuple(CameraClock(camera.name, 0.0, 1.0, known[camera.name]) for camera in cameras)
    clocks = starting_as_declared(times, clocks, starts_s)
    refusals, warnings = precision_doubts(times, clocks)
    if refusals:
        return anywhere
    message = "The offsets are as declared, since motion does not tell them."
    as_declared = Problem(SYNC_AS_DECLARED, message, hint=anywhere.refusals[0].hint)
    return replace(anywhere, clocks=clocks, refusals=(), warnings=(as_declared, *warnings))


def beyond_declared(
    clocks: Sequence[CameraClock], times: Mapping[str, FrameTimes], known_s: Mapping[str, float]
) -> dict[str, float]:
    """Differences from declared offsets that are beyond their uncertainty, in seconds by camera.

    Clocks are compared in the middle of the take, relative to the median of all cameras with an uncertainty.
    """
    shift_s = {}
    for clock in clocks:
        if clock.camera in known_s:
            middle_s = times[clock.camera].time_s[[0, -1]].mean(keepdims=True)
            shift_s[clock.camera] = float(clock.session_s(middle_s)[0] - middle_s[0])
    common_s = float(np.median(list(shift_s.values())))
    allowed_s = {name: max(_ALWAYS_NEAR_S, _MAX_SIGMAS * std_s) for name, std_s in known_s.items()}
    apart_s = {name: value - common_s for name, value in shift_s.items()}
    return {name: value for name, value in apart_s.items() if abs(value) > allowed_s[name]}


def _beyond(camera: str, apart_s: float, known_s: Mapping[str, float]) -> Problem:
    message = (
        f"By the motion of people the camera started {abs(apart_s):.3f} s {'later' if apart_s > 0 else 'earlier'} than "
        f"it was declared, with a standard deviation of {known_s[camera]:.3f} s."
    )
    hint = "Look at the motion; the clock of the camera was wrong, or its pictures came late."
    return Problem(SYNC_BEYOND_DECLARED, message, camera=camera, hint=hint)


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
    from pipeline.video.sound import listen_in_child  # noqa: PLC0415 - loads FFmpeg, and seldom needed

    sounds: dict[str, Float32[np.ndarray, " ms"] | str] = {}
    for camera, video in session.camera_videos.items():
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
    yield from (from_problem(warning, "warning") for warning in synchronization.warnings)
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
