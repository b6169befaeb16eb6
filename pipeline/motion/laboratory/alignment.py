"""Clock of a laboratory's file, measured from the contacts of the feet and the vertical force of the plates.

Coarse: the time at which feet stand on the plates agrees best with the time for which the plates are loaded. Fine:
while a person stands on plates alone, twice the integral of the force over mass and gravity is the height of the centre
of mass, but for its height and velocity at the start. The lag and the mass with the least squares are taken. Where no
centre of mass is known, or plates carry a person never alone, beginnings and ends of contacts tell the lag.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, find_peaks, savgol_filter
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.laboratory import ForcePlate, Laboratory, LaboratoryCheck, LaboratoryStart
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import SIDES, JointSet
from pipeline.motion.balance.compute import GRAVITY_M_S2, balance_of, margins_of
from pipeline.motion.laboratory.plates import LOADED_N, force_plates
from pipeline.motion.skeleton.feet.floor import find_runs

# Rate of the coarse search; distance of a foot from a plate on which it may stand; candidates and their distance.
_COARSE_HZ, _BESIDE_M, _MAX_CANDIDATES, _APART_S = 100.0, 0.1, 6, 0.2
# Range of the fine search about a candidate and its step; time in which a contact's end may be wrong; least length of
# a piece of support, and its largest, in which drift of a plate counts for nothing.
_FINE_S, _STEP_S, _UNSURE_S, _SHORTEST_S, _LONGEST_S = 0.12, 0.01, 0.05, 0.25, 1.5
# Share of the best score that a candidate has at least.
_COMPARABLE = 0.5
# A second candidate with less than this multiple of the best one's squares makes the clock ambiguous.
_AMBIGUOUS = 1.3
# Contacts and loads belong together whose ends are not farther apart; common error of a person's contacts.
_TOGETHER_S, _CONTACT_S = 0.15, 0.02
# Largest deviation of a fit that tells the clock, masses of people, and time of a parabola through heights.
_MAX_SIGMA_S, _MASSES_KG, _SMOOTH_S = 0.02, (10.0, 300.0), 0.2


class _Support(NamedTuple):
    """A person on the plates, in the rows of the motion."""

    time_s: Float[np.ndarray, " rows"]
    height_m: Float[np.ndarray, " rows"]  # Of the centre of mass, NaN where unknown
    on_plate: Bool[np.ndarray, "rows feet plates"]  # A foot is on the floor on a plate
    beside: Bool[np.ndarray, " rows"]  # A foot is on the floor on none


def in_world_of(cameras: Sequence[Camera], before: Sequence[Camera], laboratory: Laboratory) -> Laboratory:
    """Laboratory in the world of cameras that were refined, which may have moved together."""
    if all(new is old for new, old in zip(cameras, before, strict=False)):
        return laboratory
    moves = [new.cam_from_world.inverse() @ old.cam_from_world for new, old in zip(cameras, before, strict=False)]
    turn = Rotation.from_matrix([move.rotation for move in moves]).mean().as_matrix()
    world_from_old = Rigid3(turn, np.mean([move.translation_m for move in moves], axis=0))
    return replace(laboratory, world_from_laboratory=world_from_old @ laboratory.world_from_laboratory)


def placed_in_time(
    laboratory: Laboratory, animation: Animation, joints: JointSet, timebase: Timebase, subject: Subject
) -> Laboratory:
    """Laboratory with the time of its first frame, if it is stated or can be measured, and a check by the feet."""
    plates = force_plates(laboratory)
    check = measure_start(laboratory, plates, animation, joints, timebase, subject)
    start = laboratory.start or check.measured
    if start is not None:
        check = check._replace(apart_m=_apart_m(laboratory, plates, animation.tracks, joints, timebase, start.time_s))
    return replace(laboratory, start=start, check=check)


def _apart_m(
    laboratory: Laboratory,
    plates: Sequence[ForcePlate],
    tracks: Sequence[Track3D],
    joints: JointSet,
    timebase: Timebase,
    start_s: float,
) -> float | None:
    """Median distance of the centres of pressure from the nearest ankle, on the floor."""
    columns = [joints.index(f"{side}_ankle") for side in SIDES if f"{side}_ankle" in joints.names]
    apart_m: list[float] = []
    for track in tracks:
        time_s = timebase.start_time_s + np.array(track.frames) / timebase.frame_rate_hz
        rows = np.round((time_s - start_s) * laboratory.sample_rate_hz).astype(int)
        inside = (rows >= 0) & (rows < len(laboratory.samples))
        for plate in plates if columns else ():
            of_feet_m = track.xyz_m[inside][:, columns, :2] - plate.centre_of_pressure_m[rows[inside], None, :2]
            nearest_m = np.linalg.norm(of_feet_m, axis=-1).min(1)
            apart_m += nearest_m[np.isfinite(nearest_m)].tolist()
    return float(np.median(apart_m)) if apart_m else None


def measure_start(
    laboratory: Laboratory,
    plates: Sequence[ForcePlate],
    animation: Animation,
    joints: JointSet,
    timebase: Timebase,
    subject: Subject,
) -> LaboratoryCheck:
    """Measure when the first frame of a laboratory's file was, on the clock of the output frames."""
    pairs = zip(animation.motions, animation.tracks, strict=True)
    everyone = [_support(*pair, joints, timebase, plates, subject) for pair in pairs]
    people = [person for person in everyone if len(person.time_s) > 1 and person.on_plate.any()]
    if not people:
        return LaboratoryCheck(None, False, None, None)
    force_n = np.stack([plate.force_n[:, 2] for plate in plates])
    rate_hz, loaded, total_n = laboratory.sample_rate_hz, np.asarray(force_n > LOADED_N), force_n.sum(0)
    person = max(people, key=lambda person: int(person.on_plate.any((1, 2)).sum()))
    alone = _alone(person, [other for other in people if other is not person])
    by_contacts_s = _by_contacts(people, loaded, rate_hz)
    candidates_s = [*by_contacts_s, *_by_weight(person, alone, total_n, rate_hz)]
    fits = [fit for lag_s in candidates_s if (fit := _fine(person, alone, total_n, rate_hz, lag_s)) is not None]
    # A fit is good without reason if the file covers little of the support.
    fits = [fit for fit in fits if 2 * fit.num_rows >= max(other.num_rows for other in fits)]
    if fits:
        alike = [fit for fit in fits if fit.square_m2 <= _AMBIGUOUS * min(other.square_m2 for other in fits)]
        best = alike[0]
        if best.sigma_s < _MAX_SIGMA_S:
            is_ambiguous = any(abs(fit.lag_s - best.lag_s) > _APART_S / 2 for fit in alike)
            start = LaboratoryStart("contacts", -best.lag_s, best.sigma_s)
            return LaboratoryCheck(start, is_ambiguous, best.mass_kg, None)
    ends = [_by_ends(people, loaded, rate_hz, lag_s) for lag_s in by_contacts_s[:1]]
    starts = [LaboratoryStart("contacts", -lag_s, sigma_s) for lag_s, sigma_s in filter(None, ends)]
    return LaboratoryCheck(next(iter(starts), None), len(by_contacts_s) > 1, None, None)


def _support(
    motion: SkeletonMotion,
    track: Track3D,
    joints: JointSet,
    timebase: Timebase,
    plates: Sequence[ForcePlate],
    subject: Subject,
) -> _Support:
    num_rows = len(motion.root_m)
    stands = np.zeros((num_rows, len(SIDES)), bool)
    for contact in motion.contacts:
        stands[contact.rows, SIDES.index(contact.side)] = True
    on_plate = np.zeros((num_rows, len(SIDES), len(plates)), bool)
    for side, name in enumerate(SIDES):
        marks = [f"{name}_{part}" for part in ("heel", "big_toe") if f"{name}_{part}" in joints.names]
        columns = [joints.index(mark) for mark in marks or [f"{name}_ankle"] if mark in joints.names]
        if columns and plates:
            place_m = np.nan_to_num(track.xyz_m[:, columns, :2].mean(1), nan=1e9)  # far from every plate
            inside_m = np.stack(
                [margins_of(np.broadcast_to(plate.corners_m[:, :2], (num_rows, 4, 2)), place_m) for plate in plates]
            )
            # The plate that is nearest to the foot's middle carries it.
            rows = np.flatnonzero(stands[:, side] & (inside_m.max(0) > -_BESIDE_M))
            on_plate[rows, side, inside_m.argmax(0)[rows]] = True
    balance = balance_of(motion, track, joints, subject)
    height_m = np.full(num_rows, np.nan) if balance is None else balance.centre_m[:, 2]
    time_s = timebase.start_time_s + np.arange(motion.start_frame, motion.start_frame + num_rows) / motion.frame_rate_hz
    return _Support(time_s, height_m, on_plate, np.asarray((stands & ~on_plate.any(2)).any(1)))


def _by_contacts(people: Sequence[_Support], loaded: Bool[np.ndarray, "plates samples"], rate_hz: float) -> list[float]:
    """Lags, best first, at which feet on plates and loads agree; a lag is the file's time less the capture's."""
    begin_s, end_s = min(person.time_s[0] for person in people), max(person.time_s[-1] for person in people)
    grid_s = np.arange(begin_s, end_s, 1.0 / _COARSE_HZ)
    stands = np.zeros((loaded.shape[0], len(grid_s)))
    for person in people:
        rows = np.clip(np.searchsorted(person.time_s, grid_s), 0, len(person.time_s) - 1)
        inside = (grid_s >= person.time_s[0]) & (grid_s <= person.time_s[-1])
        stands = np.maximum(stands, (np.asarray(person.on_plate.any(1))[rows] & inside[:, None]).T)
    carries = loaded[:, _coarse_rows(loaded.shape[1], rate_hz)].astype(float)
    score = np.zeros(carries.shape[1] + len(grid_s) - 1)
    for load, foot in zip(carries, stands, strict=True):
        both = correlate(load, foot, method="fft")
        score += both - correlate(load, 1.0 - foot, method="fft") - correlate(1.0 - load, foot, method="fft")
    return _best_lags(score, len(grid_s), begin_s)


def _coarse_rows(num_samples: int, rate_hz: float) -> Int[np.ndarray, " rows"]:
    """Samples at the times of the coarse search, each before the end, at which rounding may put the last one."""
    return np.minimum((np.arange(0.0, num_samples / rate_hz, 1.0 / _COARSE_HZ) * rate_hz).astype(int), num_samples - 1)


def _alone(person: _Support, others: Sequence[_Support]) -> Bool[np.ndarray, " rows"]:
    """Rows in which plates carry a person, and nothing else does or is on them."""
    unsure = person.beside.copy()
    for other in others:
        unsure |= np.interp(person.time_s, other.time_s, other.on_plate.any((1, 2)), left=0.0, right=0.0) > 0.0
    around = 2 * max(round(_UNSURE_S / _step_s(person)), 1) + 1
    free = np.convolve(unsure, np.ones(around), "same") < 0.5 if len(unsure) >= around else ~unsure
    return np.asarray(person.on_plate.any((1, 2)) & np.isfinite(person.height_m) & free)


def _step_s(person: _Support) -> float:
    return float(np.median(np.diff(person.time_s)))


def _by_weight(
    person: _Support, alone: Bool[np.ndarray, " rows"], force_n: Float[np.ndarray, " samples"], rate_hz: float
) -> list[float]:
    """Lags, best first, at which the force goes with gravity and the acceleration of the centre of mass."""
    window = max(2 * round(_SMOOTH_S / _step_s(person) / 2) + 1, 5)
    if alone.sum() < 2 * window:
        return []
    rows = np.arange(len(alone))
    known = np.isfinite(person.height_m)
    height_m = np.interp(rows, rows[known], person.height_m[known])
    rise_m_s2 = savgol_filter(height_m, window, 2, deriv=2, delta=_step_s(person))
    grid_s = np.arange(person.time_s[0], person.time_s[-1], 1.0 / _COARSE_HZ)
    used = np.interp(grid_s, person.time_s, alone) > 0.99
    weight = np.where(used, 1.0 + np.interp(grid_s, person.time_s, rise_m_s2) / GRAVITY_M_S2, 0.0)
    edges = _coarse_rows(len(force_n), rate_hz)
    # Below the rate of the search, a sample is the mean of several steps.
    mean_n = np.add.reduceat(force_n, edges) / np.maximum(np.diff(edges, append=len(force_n)), 1)
    always = np.ones_like(mean_n)
    pairs = (mean_n**2, used * 1.0), (mean_n, weight), (always, weight**2), (always, used * 1.0)
    force, product, square, count = (correlate(*pair, method="fft") for pair in pairs)
    covered = (count >= count.max() / 2.0) & (force > count * LOADED_N**2)
    score = np.where(covered, product**2 / np.where(covered, force * square, 1.0), 0.0)
    return _best_lags(score, len(grid_s), float(grid_s[0]))


def _best_lags(score: Float[np.ndarray, " lags"], num_grid: int, begin_s: float) -> list[float]:
    """Lags of the highest peaks of a score."""
    peaks = find_peaks(np.pad(score, 1, constant_values=-np.inf), distance=_APART_S * _COARSE_HZ)[0] - 1
    high = peaks[score[peaks] > _COMPARABLE * max(float(score.max()), 0.0)]
    best = sorted(high, key=lambda peak: -score[peak])[:_MAX_CANDIDATES]
    return [float((peak - num_grid + 1) / _COARSE_HZ - begin_s) for peak in best]


class _Fit(NamedTuple):
    """Fit of the height of the centre of mass by the force."""

    square_m2: float  # Mean square of what is left
    lag_s: float
    sigma_s: float
    mass_kg: float
    num_rows: int


def _fine(
    person: _Support,
    alone: Bool[np.ndarray, " rows"],
    force_n: Float[np.ndarray, " samples"],
    rate_hz: float,
    lag_s: float,
) -> _Fit | None:
    """Best fit near a lag; ``None`` without support."""
    own_s = np.arange(len(force_n)) / rate_hz
    reach_s = person.time_s + lag_s
    alone = alone & (reach_s > own_s[0] + _FINE_S) & (reach_s < own_s[-1] - _FINE_S)
    pieces = [rows for run in find_runs(alone) for rows in _cut(*run, person.time_s)]
    if not pieces:
        return None
    impulse = force_n
    for _ in range(2):
        impulse = cumulative_trapezoid(impulse, dx=1.0 / rate_hz, initial=0.0)
    times_s = [person.time_s[rows] for rows in pieces]
    lines = [np.stack([np.ones_like(time_s), time_s - time_s.mean()], axis=1) for time_s in times_s]
    bases = [np.linalg.qr(line)[0] for line in lines]

    def without_line(series: Iterable[Float[np.ndarray, " rows"]]) -> Float[np.ndarray, " rows"]:
        """Series of the pieces without their start's height and velocity, one behind the other."""
        parts = zip(bases, series, strict=True)
        return np.concatenate([values - basis @ (basis.T @ values) for basis, values in parts])

    fall_m = (GRAVITY_M_S2 / 2.0 * (time_s - time_s[0]) ** 2 for time_s in times_s)
    given = without_line(person.height_m[rows] + fallen_m for rows, fallen_m in zip(pieces, fall_m, strict=True))

    def fitted(lag: float) -> tuple[float, float, np.ndarray]:
        of_force = without_line(np.interp(time_s + lag, own_s, impulse) for time_s in times_s)
        inverse_mass = float(of_force @ given / max(of_force @ of_force, 1e-12))
        left = given - inverse_mass * of_force
        return float(left @ left), inverse_mass, left

    lags_s = lag_s + np.arange(-_FINE_S, _FINE_S, _STEP_S)
    near_s = lags_s[np.argmin([fitted(lag)[0] for lag in lags_s])]
    bounds, options = (near_s - _STEP_S, near_s + _STEP_S), {"xatol": 1e-6}
    best_s = float(minimize_scalar(lambda lag: fitted(lag)[0], bounds=bounds, method="bounded", options=options).x)
    squares, inverse_mass, left = fitted(best_s)
    around = [fitted(best_s + step)[0] for step in (-_STEP_S / 2, _STEP_S / 2)]
    curvature = (sum(around) - 2.0 * squares) / (_STEP_S / 2) ** 2
    free = len(left) - 2 * len(pieces) - 2
    if free < 1 or curvature <= 0.0 or not 1.0 / _MASSES_KG[1] < inverse_mass < 1.0 / _MASSES_KG[0]:
        return None
    # Neighbouring errors are alike: as many count as are independent.
    alike = float(np.clip(left[1:] @ left[:-1] / max(squares, 1e-30), 0.0, 0.98))
    variance = squares / free * (1.0 + alike) / (1.0 - alike)
    return _Fit(squares / free, best_s, float(np.sqrt(2.0 * variance / curvature)), 1.0 / inverse_mass, len(left))


def _cut(start: int, stop: int, time_s: Float[np.ndarray, " rows"]) -> list[slice]:
    """Pieces of a run of support, none too short."""
    length_s = float(time_s[stop - 1] - time_s[start])
    if length_s < _SHORTEST_S or stop - start < 5:
        return []
    borders = np.linspace(start, stop, int(np.ceil(length_s / _LONGEST_S)) + 1).round().astype(int)
    return [slice(*pair) for pair in pairwise(borders)]


def _by_ends(
    people: Sequence[_Support], loaded: Bool[np.ndarray, "plates samples"], rate_hz: float, lag_s: float
) -> tuple[float, float] | None:
    """Lag and its deviation by beginnings and ends of contacts and loads; ``None`` with fewer than two contacts."""
    found: list[float] = []
    for number, load in enumerate(loaded):
        ends_s = np.array(find_runs(load), float).reshape(-1, 2) / rate_hz
        for person in people:
            step_s = _step_s(person)
            for start, stop in find_runs(np.asarray(person.on_plate[:, :, number].any(1))):
                of_foot_s = np.array([person.time_s[start], person.time_s[stop - 1] + step_s]) - step_s / 2
                apart_s = ends_s - of_foot_s - lag_s
                near = np.abs(apart_s).max(1) < _TOGETHER_S
                # Feet are seen to stand later than they do, and shorter: errors of both ends cancel in part.
                found += (apart_s[near].mean(1) + lag_s).tolist()
    if len(found) < 2:
        return None
    middle_s = float(np.median(found))
    spread_s = 1.4826 * float(np.median(np.abs(np.array(found) - middle_s)))
    return middle_s, float(np.hypot(spread_s / np.sqrt(len(found)), _CONTACT_S))
