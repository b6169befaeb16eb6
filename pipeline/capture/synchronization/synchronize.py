"""Synchronisation from people: the whole way."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from jaxtyping import Int

from pipeline.capture.synchronization.clock_checks import find_doubts
from pipeline.capture.synchronization.coarse import find_splits, likely_lags, shift_curve, solve_offsets
from pipeline.capture.synchronization.groups import match_pairs, match_people
from pipeline.capture.synchronization.motions import STEP_S, BodyMotion, find_motions
from pipeline.capture.synchronization.pair_curves import PairCurve, compare_pair
from pipeline.capture.synchronization.refine_clocks import FineClocks, refine_clocks
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, CameraClock, ClockEvidence, FrameTimes, Synchronization
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.core.progress import OnShare, ignore

# Lags that are compared, in grid steps: around the declared times, around lags that speeds propose, and around the
# offsets that were found; and the step between two of them.
_DECLARED_REACH, _PROPOSED_REACH, _FINAL_REACH, _LAG_STEP = 125, 25, 75, 2
# Cameras with the best agreement to which each camera is compared at last; of few cameras all pairs are.
_PARTNERS = 6
# Takes that are long enough for rates of clocks to matter and to be measured.
_MIN_DRIFT_S = 30.0
# Evidence is kept around the offset that was found.
_SHOWN_S = 2.5
KNOWN_WITHIN_S = _PROPOSED_REACH * STEP_S
"""Distance up to which lags are compared around those that are known roughly."""
NOTHING_KNOWN: Mapping[str, float] = MappingProxyType({})


def synchronize(
    cameras: Sequence[Camera],
    times: Mapping[str, FrameTimes],
    detections: Mapping[str, Detections],
    joints: JointSet,
    starts_s: Mapping[str, float],
    on_share: OnShare = ignore,
    near_s: Mapping[str, float] = NOTHING_KNOWN,
    pairs: Sequence[tuple[int, int]] | None = None,
) -> Synchronization:
    """Measure the cameras' clocks from the motion of people seen by several cameras.

    Bodies are followed in each camera by itself. Two cameras agree at a lag of their clocks if joints in motion lie on
    each other's epipolar lines. The coarse offsets maximise the agreement of all pairs; Gauss-Newton on the epipolar
    errors of all joints refines them, with rates in takes of half a minute or more.

    - ``cameras``: calibrated cameras. The rate of the first one's clock stays as it is, and uncertainties are relative
      to it. The session begins when it was declared to begin.
    - ``times``, ``detections``: declared frame times and bodies by camera. Nothing is known of the offsets: they are
      looked for over the whole take. ``motions.excerpt`` gives the bodies of a long take that are enough.
    - ``starts_s``: declared time at which each camera's own time is 0, by camera.
    - ``near_s``: corrections of declared times that are known roughly, by camera, such as from sound: of two such
      cameras only lags within half a second of these are compared.
    - ``pairs``: pairs of cameras to compare, by their numbers, the smaller one first; all of them by default.
    - Returns clocks, with reasons not to rely on them if there are any: nothing is raised.
    """
    motions = find_motions(cameras, times, detections, joints)
    on_share(0.2)
    pairs = list(itertools.combinations(range(len(cameras)), 2)) if pairs is None else pairs
    known = {number: near_s[camera.name] for number, camera in enumerate(cameras) if camera.name in near_s}
    curves = [compare_pair(cameras, pair, motions, _measure_lags(motions, pair, known)) for pair in pairs]
    on_share(0.6)
    offsets = solve_offsets(curves, len(cameras))
    curves = [
        curve if known.keys() >= {curve.first, curve.second} else _around(cameras, motions, curve, offsets)
        for curve in _best(curves, len(cameras))
    ]
    offsets = solve_offsets(curves, len(cameras))
    on_share(0.8)
    splits = [shift_curve(curves, offsets, group) for group in find_splits(curves, len(cameras))]
    compared = [(curve.first, curve.second) for curve in curves]
    matches = match_people(match_pairs(cameras, motions, offsets, compared), motions, offsets, compared)
    fine = refine_clocks(cameras, motions, matches, offsets * STEP_S, shows_drift(motions))
    clocks = camera_clocks(cameras, times, fine)
    late_s = _late_s(times, clocks)
    clocks = starting_as_declared(times, clocks, starts_s)
    refusals, warnings = find_doubts(cameras, times, motions, splits, clocks, offsets)
    on_share(1.0)
    evidence = tuple(_evidence(number, clock, curves, offsets, late_s) for number, clock in enumerate(clocks))
    return Synchronization(clocks, refusals, warnings, evidence)


def corrected_times(times: Mapping[str, FrameTimes], synchronization: Synchronization) -> dict[str, FrameTimes]:
    """Frame times on the session's clock, from declared ones."""
    clocks = {clock.camera: clock for clock in synchronization.clocks}
    return {
        name: FrameTimes(read_only(clocks[name].session_s(frame_times.time_s))) for name, frame_times in times.items()
    }


def starting_as_declared(
    times: Mapping[str, FrameTimes], clocks: Sequence[CameraClock], starts_s: Mapping[str, float]
) -> tuple[CameraClock, ...]:
    """Clocks moved together so that the session begins when it was declared to begin."""
    late_s = _late_s(times, clocks)
    return tuple(
        replace(clock, shift_s=clock.shift_s - late_s, start_s=float(starts_s[clock.camera])) for clock in clocks
    )


def _measure_lags(
    motions: Sequence[BodyMotion], pair: tuple[int, int], known_s: Mapping[int, float]
) -> Int[np.ndarray, " lags"]:
    """Lags to compare: those near known ones, or small ones and those near which the speeds of people are alike."""
    if known_s.keys() >= set(pair):
        return np.array(_window(round((known_s[pair[1]] - known_s[pair[0]]) / STEP_S), _PROPOSED_REACH))
    lags = set(_window(0, _DECLARED_REACH))
    for lag in likely_lags(motions, pair):
        lags.update(_window(lag, _PROPOSED_REACH))
    return np.array(sorted(lags))


def _window(middle: int, reach: int) -> range:
    return range((middle - reach) // _LAG_STEP * _LAG_STEP, middle + reach + 1, _LAG_STEP)


def _around(
    cameras: Sequence[Camera], motions: Sequence[BodyMotion], curve: PairCurve, offsets: Int[np.ndarray, " cameras"]
) -> PairCurve:
    """Curve of a pair with the lags around the offsets, beside those that were compared already."""
    lag = int(offsets[curve.second] - offsets[curve.first])
    missing = np.setdiff1d(np.array(_window(lag, _FINAL_REACH)), curve.lags)
    if not len(missing):
        return curve
    more = compare_pair(cameras, (curve.first, curve.second), motions, missing)
    lags = np.concatenate([curve.lags, missing])
    order = np.argsort(lags)
    gain, cost, weight = (
        read_only(np.concatenate(both)[order])
        for both in ((curve.gain, more.gain), (curve.cost, more.cost), (curve.weight, more.weight))
    )
    return PairCurve(curve.first, curve.second, lags[order], gain, cost, weight)


def _best(curves: Sequence[PairCurve], num_cameras: int) -> list[PairCurve]:
    kept: set[int] = set()
    for camera in range(num_cameras):
        own = [number for number, curve in enumerate(curves) if camera in (curve.first, curve.second)]
        kept.update(sorted(own, key=lambda number: -curves[number].gain.max(initial=0.0))[:_PARTNERS])
    return [curves[number] for number in sorted(kept)]


def shows_drift(motions: Sequence[BodyMotion]) -> bool:
    """True if motions last long enough for rates of clocks to matter and to be measured."""
    first = min((motion.first for motion in motions), default=0)
    return (max((motion.stop for motion in motions), default=0) - first) * STEP_S >= _MIN_DRIFT_S


def camera_clocks(
    cameras: Sequence[Camera], times: Mapping[str, FrameTimes], fine: FineClocks
) -> tuple[CameraClock, ...]:
    """Clocks of cameras, with their uncertainty at the ends of the cameras' frames."""
    return tuple(_clock(number, camera, fine, times[camera.name]) for number, camera in enumerate(cameras))


def _clock(number: int, camera: Camera, fine: FineClocks, times: FrameTimes) -> CameraClock:
    num_cameras = len(fine.offset_s)
    drift = float(fine.drift[number])
    own = [number, number + num_cameras]
    covariance = fine.covariance[np.ix_(own, own)]
    ends = [np.array([1.0, float(time_s) - fine.pivot_s]) for time_s in times.time_s[[0, -1]]]
    sigma_s = max(float(np.sqrt(max(end @ covariance @ end, 0.0))) for end in ends)
    return CameraClock(camera.name, float(fine.offset_s[number]) - drift * fine.pivot_s, 1.0 + drift, sigma_s)


def _late_s(times: Mapping[str, FrameTimes], clocks: Sequence[CameraClock]) -> float:
    declared_s = [times[clock.camera].time_s[:1] for clock in clocks]
    starts_s = [clock.session_s(first_s) for clock, first_s in zip(clocks, declared_s, strict=True)]
    return float(np.min(starts_s) - np.min(declared_s))


def _evidence(
    number: int, clock: CameraClock, curves: Sequence[PairCurve], offsets: Int[np.ndarray, " cameras"], late_s: float
) -> ClockEvidence:
    """Share of the moving joints that disagree, by offset of a camera."""
    cost: dict[int, float] = {}
    weight: dict[int, float] = {}
    for curve in curves:
        if number not in (curve.first, curve.second):
            continue
        sign, other = (1, curve.first) if number == curve.second else (-1, curve.second)
        for k, shift in enumerate((sign * curve.lags + offsets[other]).tolist()):
            if curve.weight[k] > 0:
                cost[shift] = cost.get(shift, 0.0) + float(curve.cost[k] * curve.weight[k])
                weight[shift] = weight.get(shift, 0.0) + float(curve.weight[k])
    offset_s = {shift: shift * STEP_S - late_s + clock.start_s for shift in sorted(weight)}
    shown = [shift for shift, value_s in offset_s.items() if abs(value_s - clock.offset_s) <= _SHOWN_S]
    return ClockEvidence(
        clock.camera, tuple(offset_s[shift] for shift in shown), tuple(cost[shift] / weight[shift] for shift in shown)
    )
