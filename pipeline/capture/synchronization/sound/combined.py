"""Clocks from sound and motion together: sound gives the coarse offsets, motion the fine ones and the check."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from pipeline.capture.synchronization.checks import precision_doubts
from pipeline.capture.synchronization.sound.offsets import SoundOffsets
from pipeline.capture.synchronization.synchronize import starting_as_declared, synchronize
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.errors import Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.findings import SYNC_BY_SOUND, SYNC_CONTRADICTION
from pipeline.core.progress import OnShare, ignore

# Motion and sound may differ so much: sound and pictures of phones are some hundredths apart, and sound takes its way.
_MAX_APART_S = 0.1
_HINT = "Declare the offsets, or send videos without sound that was edited."


def synchronize_with_sound(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    starts_s: Mapping[str, float],
    sound: SoundOffsets,
    on_share: OnShare = ignore,
) -> Synchronization:
    """Measure the cameras' clocks as ``synchronize`` does, with the help of sound.

    Motion alone comes first. If it is certain, sound has to agree within a tenth of a second. If it is not (it repeats
    itself, say), only offsets near the sound's are compared. If motion tells nothing of them either, and all cameras
    have sound, the clocks come from sound, whose standard deviation includes the way of the sound.
    """
    by_people = synchronize(cameras, times, detections, joints, starts_s, on_share)
    shift_s = {name: value - starts_s[name] for name, value in sound.offset_s.items()}
    if len(shift_s) < 2:
        return by_people
    if by_people.is_certain:
        return replace(by_people, refusals=tuple(_contradictions(by_people.clocks, shift_s, times)))
    near = synchronize(cameras, times, detections, joints, starts_s, on_share, near_s=shift_s)
    if near.is_certain and not any(_contradictions(near.clocks, shift_s, times)):
        return near
    if len(shift_s) < len(cameras):
        return by_people
    clocks = tuple(
        CameraClock(camera.name, shift_s[camera.name], 1.0, sound.sigma_s[camera.name]) for camera in cameras
    )
    clocks = starting_as_declared(times, clocks, starts_s)
    refusals, warnings = precision_doubts(times, clocks)
    if not refusals:
        message = "The offsets come from the sound alone, since motion does not tell them: +-3 ms a metre of its way."
        warnings = (Problem(SYNC_BY_SOUND, message, hint=by_people.refusals[0].hint), *warnings)
    return replace(by_people, clocks=clocks, refusals=refusals, warnings=warnings)


def _contradictions(
    clocks: Sequence[CameraClock], shift_s: Mapping[str, float], times: Mapping[str, FrameTimes]
) -> Iterator[Problem]:
    """Cameras whose offsets from motion and from sound differ, relative to the first camera with sound."""
    heard = [clock for clock in clocks if clock.camera in shift_s]
    differences_s = {}
    for clock in heard:
        middle_s = times[clock.camera].time_s[[0, -1]].mean(keepdims=True)
        differences_s[clock.camera] = float(clock.session_s(middle_s)[0] - middle_s[0]) - shift_s[clock.camera]
    first_s = differences_s[heard[0].camera]
    for clock in heard[1:]:
        apart_s = differences_s[clock.camera] - first_s
        if abs(apart_s) > _MAX_APART_S:
            message = (
                f"Motion and sound contradict each other: by the sound the camera started {abs(apart_s):.2f} s "
                f"{'earlier' if apart_s > 0 else 'later'} than by the motion of people."
            )
            yield Problem(SYNC_CONTRADICTION, message, camera=clock.camera, hint=_HINT)
