"""Doubts about clocks: what refuses them, and what a user should know."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from pipeline.capture.synchronization.coarse import CameraSplit
from pipeline.capture.synchronization.motions import STEP_S, BodyMotion
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes
from pipeline.core.errors import Problem
from pipeline.core.problems import finding_codes
from pipeline.video.frame_rate import measured_rate_hz

_DECLARE = "Give the offset of each camera."
_FILM = "Let a person walk about and wave where all cameras see them, at the start of each take."
# Least agreement across a split: so many joints in motion.
_MIN_GAIN = 10.0
# Least motion of all bodies that a camera sees, and the time that it has to share with the others.
_MIN_MOTION, _MIN_SHARED_S = 20.0, 0.5
# Largest agreement elsewhere, as a share of the best: of an answer apart, and of a slope that is nearly flat.
_MAX_RIVAL, _MAX_FLAT = 0.6, 0.75
# Distance at which an answer is another one, and rise of the agreement that is noise.
_FAR_S, _NOISE = 0.2, 0.02
# Standard deviation up to which clocks are used: this share of a frame, but no less than a time. With half a frame for
# three standard deviations no warning is needed.
_MAX_SIGMA_FRAMES, _ALWAYS_FINE_S, _GOOD_SIGMA_FRAMES = 0.5, 0.010, 1.0 / 6.0


def find_doubts(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    motions: Sequence[BodyMotion],
    splits: Sequence[CameraSplit],
    clocks: Sequence[CameraClock],
    offsets: Int[np.ndarray, " cameras"],
) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    """Find reasons to refuse clocks, and warnings.

    ``splits`` have the agreement across each split at shifts of the found offsets.
    """
    refusals = list(_unlinked(cameras, times, motions, splits, offsets))
    if not refusals:
        refusals = [*_ambiguous(cameras, splits), *_uncertain(times, clocks)]
    warnings = () if refusals else tuple(_imprecise(times, clocks))
    return tuple(refusals), warnings


def precision_doubts(
    times: Mapping[str, FrameTimes], clocks: Sequence[CameraClock]
) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
    """Find clocks that are not known well enough: reasons to refuse them, or warnings."""
    refusals = tuple(_uncertain(times, clocks))
    return refusals, () if refusals else tuple(_imprecise(times, clocks))


def _unlinked(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    motions: Sequence[BodyMotion],
    splits: Sequence[CameraSplit],
    offsets: Int[np.ndarray, " cameras"],
) -> Iterator[Problem]:
    """Report cameras that agree with no other camera, and why."""
    moving = np.zeros(len(cameras))
    for motion in motions:
        moving[motion.camera] += np.nan_to_num(np.minimum(1.0, motion.path)).sum()
    spans_s = [times[camera.name].time_s[[0, -1]] + offsets[k] * STEP_S for k, camera in enumerate(cameras)]
    for split in splits:
        if split.gain.max(initial=0.0) >= _MIN_GAIN:
            continue
        number = min(split.cameras)
        name = _names(cameras, split)
        others = [k for k in range(len(cameras)) if k not in split.cameras]
        pairs = [(spans_s[a], spans_s[b]) for a in split.cameras for b in others]
        shared_s = max((min(a[1], b[1]) - max(a[0], b[0]) for a, b in pairs), default=0.0)
        if all(moving[k] < _MIN_MOTION for k in split.cameras) or all(moving[k] < _MIN_MOTION for k in others):
            still = number if moving[number] < _MIN_MOTION else min(others, key=lambda k: moving[k])
            message = "The camera sees no moving person."
            yield Problem(finding_codes.SYNC_NO_MOTION, message, camera=cameras[still].name, hint=f"{_FILM} {_DECLARE}")
        elif shared_s < _MIN_SHARED_S:
            message = f"The camera shares {max(shared_s, 0.0):.1f} s with the others."
            yield Problem(finding_codes.SYNC_LITTLE_OVERLAP, message, camera=name, hint=_DECLARE)
        else:
            message = "No motion of people that the camera sees fits the other cameras, at any offset."
            hint = f"Check that it sees the same people, and its calibration. {_DECLARE}"
            yield Problem(finding_codes.SYNC_NOTHING_IN_COMMON, message, camera=name, hint=hint)


def _ambiguous(cameras: Sequence[Camera], splits: Sequence[CameraSplit]) -> Iterator[Problem]:
    """Report splits across which other shifts fit about as well."""
    for split in splits:
        rival = find_rival(split)
        if rival.share <= (_MAX_RIVAL if rival.is_separate else _MAX_FLAT):
            continue
        if rival.is_separate:
            message = (
                f"The motion fits about as well if the camera is {abs(rival.shift_s):.2f} s "
                f"{'later' if rival.shift_s > 0 else 'earlier'}: it repeats itself, or little of it is in common."
            )
            yield Problem(
                finding_codes.SYNC_AMBIGUOUS, message, camera=_names(cameras, split), hint=f"{_FILM} {_DECLARE}"
            )
        else:
            message = "People hardly move where the camera sees them: many offsets fit about as well."
            yield Problem(
                finding_codes.SYNC_NO_MOTION, message, camera=_names(cameras, split), hint=f"{_FILM} {_DECLARE}"
            )


class Rival(NamedTuple):
    """Best answer far from the best one: shift, agreement as a share of the best, and whether a valley parts both."""

    shift_s: float
    share: float
    is_separate: bool


def find_rival(split: CameraSplit) -> Rival:
    """Find the best answer beyond the valleys around the best one, or at least 0.2 s away."""
    best = int(np.argmax(split.gain))
    top = float(split.gain[best])
    low, high = best, best
    while low > 0 and split.gain[low - 1] < split.gain[low] + _NOISE * top:
        low -= 1
    while high + 1 < len(split.gain) and split.gain[high + 1] < split.gain[high] + _NOISE * top:
        high += 1
    numbers = np.arange(len(split.gain))
    is_separate = (numbers < low) | (numbers > high)
    outside = np.flatnonzero(is_separate | (np.abs(split.shifts - split.shifts[best]) * STEP_S >= _FAR_S))
    if not len(outside) or top <= 0:
        return Rival(0.0, 0.0, True)
    number = int(outside[np.argmax(split.gain[outside])])
    return Rival(
        float(split.shifts[number] - split.shifts[best]) * STEP_S,
        float(split.gain[number]) / top,
        bool(is_separate[number]),
    )


def _uncertain(times: Mapping[str, FrameTimes], clocks: Sequence[CameraClock]) -> Iterator[Problem]:
    for clock in clocks:
        limit_s = max(_MAX_SIGMA_FRAMES * _period_s(times, clock), _ALWAYS_FINE_S)
        if not clock.sigma_s <= limit_s:
            message = f"The camera's offset is known to {1000 * clock.sigma_s:.0f} ms only."
            if not np.isfinite(clock.sigma_s):
                message = "Nothing tells the camera's offset."
            yield Problem(finding_codes.SYNC_IMPRECISE, message, camera=clock.camera, hint=f"{_FILM} {_DECLARE}")


def _imprecise(times: Mapping[str, FrameTimes], clocks: Sequence[CameraClock]) -> Iterator[Problem]:
    for clock in clocks:
        frames = clock.sigma_s / _period_s(times, clock)
        if frames > _GOOD_SIGMA_FRAMES:
            message = f"The camera's offset is known to {1000 * clock.sigma_s:.1f} ms, {frames:.2f} frames."
            yield Problem(finding_codes.SYNC_UNCERTAIN, message, camera=clock.camera, hint=_FILM)


def _period_s(times: Mapping[str, FrameTimes], clock: CameraClock) -> float:
    return 1.0 / measured_rate_hz(times[clock.camera].time_s)


def _names(cameras: Sequence[Camera], split: CameraSplit) -> str:
    return ", ".join(cameras[number].name for number in sorted(split.cameras))
