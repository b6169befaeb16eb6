"""Offsets of cameras from their sound: onsets that several cameras recorded."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from pipeline.capture.synchronization.sound.onsets import Lag, find_lag, onset_strength
from pipeline.core.data.cameras import Camera
from pipeline.geometry.camera import center_in_world

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
    """Group of each camera, and its offset in its group."""
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
