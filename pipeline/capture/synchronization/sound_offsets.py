"""Onsets of sound, and the lag between the sounds of two cameras: arrays in, arrays out."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Float32
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from pipeline.capture.synchronization.clock_checks import precision_doubts
from pipeline.capture.synchronization.synchronize import starting_as_declared, synchronize
from pipeline.core.data.cameras import Camera, CameraClock, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.errors import Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import SYNC_BY_SOUND, SYNC_CONTRADICTION
from pipeline.core.progress import OnShare, ignore
from pipeline.geometry.camera import center_in_world

_MS = 1000
# An onset is a rise of the loudness over the time before; onsets are as wide as echoes and the rounding of times are.
_SHORT_MS, _BEFORE_MS, _WIDTH_MS = 4, 25, 2.0
# Rise (decades of energy) from which a sound is an onset, and how many there must be.
_RISE, _MIN_ONSETS = 0.5, 4
_BIN_MS = 10
# The best lag is so many standard deviations above the others, and the next best one this share of it at most.
_MIN_SCORE, _MAX_RIVAL, _RIVAL_MS = 8.0, 0.7, 60
_MIN_SHARED_MS = 2000
# Windows in which the lag is measured finely, around the coarse one.
_WINDOW_MS, _REACH_MS, _MIN_CORRELATION = 20_000, 80, 0.2
# Windows from which a drift is measured, and the largest one of real clocks.
_MIN_WINDOWS, _MIN_SPAN_S, _MAX_DRIFT = 4, 60.0, 5e-4
_MIN_SIGMA_S = 0.0005


@dataclass(frozen=True, slots=True)
class Lag:
    """Lag between two cameras: ``time in the first = time in the second + lag_s + drift * (that - middle_s)``."""

    # Lag at ``middle_s``, a time of the second camera, and its change
    lag_s: float
    drift: float
    middle_s: float
    sigma_s: float  # Standard deviation, from how much parts of the take disagree
    score: float  # Standard deviations by which the lag fits better than others


def onset_strength(energy: Float[np.ndarray, " ms"]) -> Float[np.ndarray, " ms"] | None:
    """Strength of onsets in each millisecond, decades of energy; ``None`` if there are few, as in silence.

    ``energy`` is the energy of each millisecond.
    """
    energy = np.asarray(energy, np.float64)
    if len(energy) < _MIN_SHARED_MS or not energy.max(initial=0.0) > 0:
        return None
    floor = max(float(np.percentile(energy, 20.0)), 1e-7 * float(energy.max()))
    level = np.log10(uniform_filter1d(energy, _SHORT_MS, origin=-(_SHORT_MS // 2)) + floor)
    before = uniform_filter1d(level, _BEFORE_MS, origin=(_BEFORE_MS - 1) // 2 - 0)
    rise = np.maximum(level - np.roll(before, 1), 0.0)
    rise[:1] = 0.0
    rise[rise < _RISE] = 0.0
    starts = np.flatnonzero((rise[1:] > 0) & (rise[:-1] == 0))
    if len(starts) < _MIN_ONSETS:
        return None
    return np.asarray(gaussian_filter1d(rise, _WIDTH_MS), np.float64)


def find_lag(first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"]) -> Lag | None:
    """Lag at which the onsets of two cameras agree best; ``None`` if no lag is clearly better than all others.

    The cross-correlation over all lags gives the coarse lag. It is measured finely in windows of 20 s, whose median is
    the lag; of takes of a minute or more a line through the windows (Theil-Sen) gives the drift too.
    """
    coarse = _coarse_lag(_binned(first), _binned(second))
    if coarse is None:
        return None
    lag_ms, score = coarse[0] * _BIN_MS, coarse[1]
    places, lags = _windows(first, second, lag_ms)
    if not len(lags):
        return None
    drift = 0.0
    middle_ms = float(np.median(places))
    if len(lags) >= _MIN_WINDOWS and (places[-1] - places[0]) / _MS >= _MIN_SPAN_S:
        left, right = np.triu_indices(len(lags), 1)
        drift = float(np.median((lags[right] - lags[left]) / (places[right] - places[left])))
        if abs(drift) > _MAX_DRIFT:
            return None
    rest = lags - drift * (places - middle_ms)
    spread = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    sigma_s = max(spread / np.sqrt(len(rest)) / _MS, _MIN_SIGMA_S)
    return Lag(float(np.median(rest)) / _MS, drift, middle_ms / _MS, sigma_s, score)


def _binned(strength: Float[np.ndarray, " ms"]) -> Float[np.ndarray, " bins"]:
    """Strongest onset of each bin of 10 ms, without the mean."""
    num_bins = len(strength) // _BIN_MS
    bins = strength[: num_bins * _BIN_MS].reshape(num_bins, _BIN_MS).max(1)
    return np.asarray(bins - bins.mean(), np.float64)


def _coarse_lag(first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"]) -> tuple[int, float] | None:
    from scipy.signal import correlate  # noqa: PLC0415 - slow to import, and seldom needed

    together = correlate(first, second, "full", method="fft")
    lags = np.arange(len(together)) - (len(second) - 1)
    # The part that both recorded, of each lag.
    begin, end = np.maximum(lags, 0), np.minimum(len(first), len(second) + lags)
    shared = end - begin
    energies = [np.r_[0.0, np.cumsum(signal**2)] for signal in (first, second)]
    norm = (energies[0][end] - energies[0][begin]) * (energies[1][end - lags] - energies[1][begin - lags])
    is_known = (shared * _BIN_MS >= _MIN_SHARED_MS) & (norm > 1e-9 * norm.max(initial=0.0))
    if not is_known.any():
        return None
    score = np.where(is_known, together / np.sqrt(np.where(is_known, norm, 1.0)) * np.sqrt(shared), -np.inf)
    known = score[is_known]
    spread = 1.4826 * float(np.median(np.abs(known - np.median(known))))
    best = int(np.argmax(score))
    apart = np.abs(lags - lags[best]) * _BIN_MS > _RIVAL_MS
    rival = float(score[apart & is_known].max(initial=0.0))
    value = float(score[best])
    if not value >= _MIN_SCORE * max(spread, 1e-12) or rival > _MAX_RIVAL * value:
        return None
    return int(lags[best]), value / max(spread, 1e-12)


def _windows(
    first: Float[np.ndarray, " m"], second: Float[np.ndarray, " n"], lag_ms: int
) -> tuple[Float[np.ndarray, " windows"], Float[np.ndarray, " windows"]]:
    """Middle of each window in the second camera's time, and the lag in it, both in ms."""
    from scipy.signal import correlate  # noqa: PLC0415 - slow to import, and seldom needed

    places, lags = [], []
    begin = max(0, _REACH_MS - lag_ms)
    end = min(len(second), len(first) - lag_ms - _REACH_MS)
    count = max(1, (end - begin) // _WINDOW_MS)
    for number in range(count):
        low, high = begin + number * (end - begin) // count, begin + (number + 1) * (end - begin) // count
        ours = second[low:high]
        theirs = first[low + lag_ms - _REACH_MS : high + lag_ms + _REACH_MS]
        if high - low < _MIN_SHARED_MS // 2 or not ours.any():
            continue
        together = correlate(theirs, ours, "valid", method="fft")
        energy = np.r_[0.0, np.cumsum(theirs**2)]
        norm = np.sqrt((energy[len(ours) :] - energy[: len(energy) - len(ours)]) * float(ours @ ours))
        value = together / np.maximum(norm, 1e-9 * norm.max(initial=1e-300))
        best = int(np.argmax(value))
        if value[best] >= _MIN_CORRELATION and 0 < best < len(value) - 1:
            left, top, right = value[best - 1 : best + 2]
            curve = left - 2.0 * top + right
            part = 0.5 * (left - right) / curve if curve < 0 else 0.0
            places.append((low + high) / 2.0)
            lags.append(lag_ms + best + float(part) - _REACH_MS)
    return np.array(places), np.array(lags)


SPEED_OF_SOUND_M_S = 343.0
"""Sound takes 2.9 ms a metre: two cameras hear one clap at times as far apart as their distances from it."""

# Cameras of which all pairs are compared; of more cameras the first one with sound is compared with each.
_ALL_PAIRS = 8
# Pairs that contradict each other by more than the way of the sound and this time are not relied on.
_TOLERANCE_S = 0.03


@dataclass(frozen=True, slots=True)
class SoundOffsets:
    """Offsets of cameras' own times, which begin at their first frames, from sound."""

    # By camera, relative to the first of them: ``session time = offset_s + own time`` in the middle of the take; none
    # if no two cameras agree
    offset_s: Mapping[str, float] = field(default_factory=dict)
    # Standard deviation by camera, with the deviation of the unknown way of the sound
    sigma_s: Mapping[str, float] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)  # Why a camera has no offset, by camera


def sound_offsets(cameras: Sequence[Camera], sounds: Mapping[str, Float32[np.ndarray, " ms"] | str]) -> SoundOffsets:
    """Offsets of cameras whose sounds agree.

    The best pairs span a tree (Kruskal 1956); the other pairs must agree with it. Cameras that no pair links to the
    largest group have no offset. ``sounds`` are the energy of each millisecond by camera, or why there is none.
    """
    reasons = {name: sound for name, sound in sounds.items() if isinstance(sound, str)}
    strengths = {}
    for camera in cameras:
        sound = sounds.get(camera.name, "The camera has no sound.")
        strength = None if isinstance(sound, str) else onset_strength(sound)
        if strength is not None:
            strengths[camera.name] = strength
        elif not isinstance(sound, str):
            reasons[camera.name] = "The sound has no onsets, such as claps or steps."
    names = list(strengths)
    pairs = (
        list(itertools.combinations(names, 2)) if len(names) <= _ALL_PAIRS else [(names[0], name) for name in names[1:]]
    )
    lags = {pair: lag for pair in pairs if (lag := find_lag(strengths[pair[0]], strengths[pair[1]])) is not None}
    group, offset_s = _tree(names, lags)
    way_s = _ways_s(cameras)
    for (first, second), lag in lags.items():
        if group[first] == group[second]:
            rest_s = offset_s[second] - offset_s[first] - lag.lag_s
            if abs(rest_s) > _TOLERANCE_S + 2.0 * way_s[first, second]:
                contradicted = dict.fromkeys(names, "The sounds of the cameras contradict each other.")
                return SoundOffsets(reasons={**reasons, **contradicted})
    linked = [name for name in names if sum(group[name] == other for other in group.values()) > 1]
    if not linked:
        alone = dict.fromkeys(names, "The sound fits no other camera's clearly: it repeats itself, or differs.")
        return SoundOffsets(reasons={**reasons, **alone})
    sizes = {root: sum(group[name] == root for name in names) for root in dict.fromkeys(group.values())}
    largest = max(sizes, key=lambda root: sizes[root])
    chosen = [name for name in names if group[name] == largest]
    reference = chosen[0]
    jitter_s = {name: max((lag.sigma_s for pair, lag in lags.items() if name in pair), default=0.0) for name in chosen}
    return SoundOffsets(
        {name: offset_s[name] - offset_s[reference] for name in chosen},
        {
            # The source is anywhere: the difference of the ways is even between minus and plus the cameras' distance.
            name: 0.0 if name == reference else float(np.hypot(jitter_s[name], way_s[reference, name] / np.sqrt(3.0)))
            for name in chosen
        },
        {
            **reasons,
            **{name: "The sound fits no other camera's clearly." for name in names if name not in chosen},
        },
    )


def _tree(names: Sequence[str], lags: Mapping[tuple[str, str], Lag]) -> tuple[dict[str, int], dict[str, float]]:
    group = {name: number for number, name in enumerate(names)}
    offset_s = dict.fromkeys(names, 0.0)
    for (first, second), lag in sorted(lags.items(), key=lambda item: -item[1].score):
        if group[first] == group[second]:
            continue
        moved = offset_s[first] + lag.lag_s - offset_s[second]
        joined = [name for name in names if group[name] == group[second]]
        for name in joined:
            offset_s[name] += moved
            group[name] = group[first]
    return group, offset_s


def _ways_s(cameras: Sequence[Camera]) -> dict[tuple[str, str], float]:
    """Time that sound takes from one camera to another."""
    centers_m = {camera.name: center_in_world(camera) for camera in cameras}
    return {
        (first, second): float(np.linalg.norm(centers_m[first] - centers_m[second])) / SPEED_OF_SOUND_M_S
        for first, second in itertools.product(centers_m, repeat=2)
    }


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
