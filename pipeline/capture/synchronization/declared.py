"""Clocks of cameras whose declared offsets have a stated uncertainty: motion refines them within it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.capture.synchronization.checks import precision_doubts
from pipeline.capture.synchronization.sound.combined import synchronize_with_sound
from pipeline.capture.synchronization.sound.offsets import SoundOffsets
from pipeline.capture.synchronization.synchronize import KNOWN_WITHIN_S, starting_as_declared, synchronize
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.errors import Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.findings import SYNC_AS_DECLARED, SYNC_BEYOND_DECLARED
from pipeline.core.progress import OnShare, ignore

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

    Parameters
    ----------
    declared_std_s
        Standard deviation of the declared offset by camera; cameras without one are looked for over the whole take.
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
