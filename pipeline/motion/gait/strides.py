"""Strides: bouts of alternating steps that carry the body, and the figures of each stride.

Lengths and widths are of footprints (Huxham et al. 2006, Gait and Posture 23): a stride leads from
a footprint to the next one of the same foot; the footprint of the other foot between them divides its length into two
steps, and its distance from the line is the width. Times are from the events: stance from foot strike to foot off,
swing from foot off to the next foot strike, double support while both feet stand.
"""

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, Self

import numpy as np
from jaxtyping import Float

from pipeline.core.data.animation import Side
from pipeline.core.joints import SIDES
from pipeline.motion.gait.events import FootEvent, Swing
from pipeline.motion.gait.points import BodyPoints

# Longest time between two strikes of a bout, and least number of its strikes.
_LONGEST_STEP_S, _FEWEST_STRIKES = 1.6, 4
# Share of the stride's way that the hips go with it, at least and at most; height of the hips as a share of the leg.
_CARRIED, _UPRIGHT = (0.6, 1.5), 0.7
# Largest turn of a stride whose figures count, and least share of the bout's median speed; it may last as much longer.
_STRAIGHT_DEG, _STEADY = 20.0, 0.8
# Share of the stance, after its start, over which a footprint is the median of the heel's positions.
_FLAT = (0.1, 0.6)


@dataclass(frozen=True, slots=True)
class Stride:
    """Stride of a foot, from a foot strike to its next one.

    Lengths are in metres, times in seconds. Double support is ``None`` where the other foot's foot off is unknown.
    """

    side: Side
    bout: int  # Number of the bout from 1
    # Rows of the track at the foot strike, the foot off, the other foot's strike and the next foot strike
    strike_row: float
    off_row: float
    other_strike_row: float
    next_row: float
    length_m: float
    step_length_m: float  # From the other foot's footprint to the next one of this foot, along the stride
    width_m: float  # Distance of the other foot's footprint from the line of the stride
    duration_s: float
    step_s: float  # From the other foot's strike to the next strike of this foot
    stance_s: float
    swing_s: float
    double_support_s: float | None
    flight_s: float  # Time with both feet in the air, as in running
    speed_m_s: float
    turn_deg: float  # Turn of the way of the hips, to the left
    is_steady: bool  # True if it counts: neither a turn nor a start or stop
    confidence: float  # Product of the confidences of its three events of this foot


def find_strides(points: BodyPoints, swings: Sequence[Swing]) -> tuple[tuple[Stride, ...], tuple[FootEvent, ...]]:
    """Find bouts of gait and their strides.

    A bout has at least four foot strikes of alternating sides, each within 1.6 s of the one before, of an upright
    person whose hips go along.

    Returns strides in order of their start, and the events of all bouts in order of time.
    """
    strides: list[Stride] = []
    events: list[FootEvent] = []
    num_bouts = 0
    steps = _Steps.from_swings(swings)
    for bout in _bouts(points, steps):
        own = _bout_strides(points, steps, bout, num_bouts + 1)
        if not own:
            continue
        num_bouts += 1
        strides += own
        events += _bout_events(steps, bout)
    return tuple(sorted(strides, key=lambda stride: stride.strike_row)), tuple(sorted(events, key=lambda e: e.row))


class _Steps(NamedTuple):
    """Events of swings, to be found without a look at all of them: a long take has thousands."""

    strikes: Mapping[FootEvent, FootEvent | None]  # In order of time, each with the foot off of its swing
    offs: Mapping[str, Sequence[FootEvent]]  # By side, in order of time
    cut_off: Sequence[FootEvent]  # Foot offs of swings without a strike

    @classmethod
    def from_swings(cls, swings: Sequence[Swing]) -> Self:
        """Events of swings."""
        strikes = {swing.strike: swing.off for swing in swings if swing.strike is not None}
        offs = sorted((swing.off for swing in swings if swing.off is not None), key=_row)
        return cls(
            {strike: strikes[strike] for strike in sorted(strikes, key=_row)},
            {side: [off for off in offs if off.side == side] for side in SIDES},
            [swing.off for swing in swings if swing.off is not None and swing.strike is None],
        )


def _row(event: FootEvent) -> float:
    return event.row


def _bouts(points: BodyPoints, steps: _Steps) -> list[list[FootEvent]]:
    """Runs of alternating foot strikes that carry the body."""
    bouts: list[list[FootEvent]] = [[]]
    for strike in steps.strikes:
        if bouts[-1] and not _continues(points, bouts[-1][-1], strike):
            bouts.append([])
        bouts[-1].append(strike)
    return [bout for bout in bouts if len(bout) >= _FEWEST_STRIKES]


def _continues(points: BodyPoints, last: FootEvent, strike: FootEvent) -> bool:
    rows = slice(int(last.row), int(strike.row) + 1)
    above_m = points.centre_m[rows, 2] - points.ankles_m[rows, :, 2].min(1)
    is_upright = float(np.median(above_m)) > _UPRIGHT * points.leg_m
    in_time = strike.row - last.row <= _LONGEST_STEP_S * points.frame_rate_hz
    return strike.side != last.side and in_time and is_upright and bool(points.known[rows].mean() > 0.5)


def _bout_events(steps: _Steps, bout: Sequence[FootEvent]) -> list[FootEvent]:
    """Strikes of a bout, and foot offs from just before its first strike to just after its last one."""
    offs = [off for strike in bout if (off := steps.strikes[strike]) is not None]
    return [*bout, *offs, *(off for off in steps.cut_off if bout[0].row < off.row and _follows(bout, off))]


def _follows(bout: Sequence[FootEvent], off: FootEvent) -> bool:
    """Return whether a foot off, whose swing the take cuts off, is the next event of a bout's foot."""
    return off.side != bout[-1].side and off.row > bout[-2].row


def _bout_strides(points: BodyPoints, steps: _Steps, bout: Sequence[FootEvent], number: int) -> list[Stride]:
    places = [_footprint_m(points, steps.offs[strike.side], strike) for strike in bout]
    strides = []
    for k in range(len(bout) - 2):
        start, other, end = bout[k : k + 3]
        off = steps.strikes[end]
        if off is None or not start.row < off.row < end.row:
            continue
        stride = _stride(points, steps.strikes[other], (start, off, other, end), places[k : k + 3], number)
        if stride is not None:
            strides.append(stride)
    if not strides:
        return []
    usual_m_s = float(np.median([stride.speed_m_s for stride in strides]))
    usual_s = float(np.median([stride.duration_s for stride in strides]))
    return [_with_steadiness(stride, usual_m_s, usual_s) for stride in strides]


def _with_steadiness(stride: Stride, usual_m_s: float, usual_s: float) -> Stride:

    is_slow = stride.speed_m_s < _STEADY * usual_m_s or stride.duration_s > usual_s / _STEADY
    is_steady = abs(stride.turn_deg) <= _STRAIGHT_DEG and not is_slow
    return replace(stride, is_steady=is_steady)


def _stride(
    points: BodyPoints,
    other_off: FootEvent | None,
    events: tuple[FootEvent, FootEvent, FootEvent, FootEvent],
    places_m: Sequence[Float[np.ndarray, " 2"]],
    number: int,
) -> Stride | None:
    """Figures of a stride; ``None`` if the hips do not go along."""
    start, off, other, end = events
    rate_hz = points.frame_rate_hz
    way_m = places_m[2] - places_m[0]
    length_m = float(np.linalg.norm(way_m))
    hips_m = [_at(points.centre_m[:, :2], event.row) for event in (start, other, end)]
    carried_m = float(np.linalg.norm(hips_m[2] - hips_m[0]))
    if length_m <= 0 or not _CARRIED[0] * length_m < carried_m < _CARRIED[1] * length_m:
        return None
    ahead = way_m / length_m
    across_m = places_m[1] - places_m[0]
    duration_s = (end.row - start.row) / rate_hz
    stance_s = (off.row - start.row) / rate_hz
    # Double support: from this strike to the other foot's foot off, and from the other strike to this foot off.
    overlaps_s = [(off.row - other.row) / rate_hz]
    if other_off is not None:
        overlaps_s.append((other_off.row - start.row) / rate_hz)
    turn_deg = np.degrees(_angle(hips_m[1] - hips_m[0], hips_m[2] - hips_m[1]))
    return Stride(
        start.side,
        number,
        start.row,
        off.row,
        other.row,
        end.row,
        length_m,
        length_m - float(across_m @ ahead),
        abs(float(ahead[0] * across_m[1] - ahead[1] * across_m[0])),
        duration_s,
        (end.row - other.row) / rate_hz,
        stance_s,
        duration_s - stance_s,
        sum(max(overlap_s, 0.0) for overlap_s in overlaps_s) if other_off is not None else None,
        sum(max(-overlap_s, 0.0) for overlap_s in overlaps_s),
        length_m / duration_s,
        float(turn_deg),
        is_steady=True,
        confidence=start.confidence * off.confidence * end.confidence,
    )


def _footprint_m(points: BodyPoints, offs: Sequence[FootEvent], strike: FootEvent) -> Float[np.ndarray, " 2"]:
    """Place of the heel on the ground in the first part of the stance that a strike begins."""
    foot = SIDES.index(strike.side)
    # A stance that the take cuts off, or in which the person stops.
    ends = [strike.row + 0.6 * points.frame_rate_hz, points.num_frames - 1.0]
    if (number := bisect_right(offs, strike.row, key=_row)) < len(offs):
        ends.append(offs[number].row)
    stop = min(ends)
    first, last = (strike.row + share * (stop - strike.row) for share in _FLAT)
    rows = slice(int(np.ceil(first)), max(int(last), int(np.ceil(first))) + 1)
    return np.asarray(np.median(points.heels_m[rows, foot, :2], axis=0))


def _at(path_m: Float[np.ndarray, "frames 2"], row: float) -> Float[np.ndarray, " 2"]:
    first = int(row)
    around_m = path_m[first : first + 2]
    return np.array([np.interp(row - first, np.arange(len(around_m)), axis) for axis in around_m.T])


def _angle(first: Float[np.ndarray, " 2"], second: Float[np.ndarray, " 2"]) -> float:
    """Angle from one direction to another, positive to the left."""
    return float(np.arctan2(first[0] * second[1] - first[1] * second[0], first @ second))


# Strides after which their number lowers the confidence no more.
_ENOUGH = 4


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and standard deviation of a figure, and the number of strides; the deviation needs two strides."""

    mean: float
    std: float | None
    num: int


@dataclass(frozen=True, slots=True, eq=False)
class GaitFigures:
    """Figures over the steady strides of a person."""

    num_strides: int
    num_bouts: int
    both: Mapping[str, Spread]
    by_side: Mapping[str, Mapping[str, Spread]]
    symmetry_percent: Mapping[str, float]  # Symmetry index of the figures of ``SYMMETRIC``, 0 if both sides are equal
    is_running: bool  # True if most strides have a flight and no double support
    confidence: float


FIGURES: Mapping[str, Callable[[Stride], float | None]] = MappingProxyType(
    {
        "stride_length_m": lambda stride: stride.length_m,
        "step_length_m": lambda stride: stride.step_length_m,
        "step_width_m": lambda stride: stride.width_m,
        "stride_time_s": lambda stride: stride.duration_s,
        "step_time_s": lambda stride: stride.step_s,
        "cadence_steps_per_min": lambda stride: 120.0 / stride.duration_s,
        "speed_m_s": lambda stride: stride.speed_m_s,
        "stance_percent": lambda stride: 100.0 * stride.stance_s / stride.duration_s,
        "swing_percent": lambda stride: 100.0 * stride.swing_s / stride.duration_s,
        "double_support_percent": lambda stride: (
            None if stride.double_support_s is None else 100.0 * stride.double_support_s / stride.duration_s
        ),
    }
)
"""Figures of each stride by name; ``None`` where a stride does not tell."""
SYMMETRIC = ("step_length_m", "step_time_s", "stance_percent")


def gait_figures(strides: Sequence[Stride]) -> GaitFigures | None:
    """Summarise the steady strides of a person; ``None`` without any.

    Symmetry is the index of Robinson et al. 1987: 200 (left - right) / (left + right), in percent.
    The confidence is the mean of the strides', times the share of four strides that there are.
    """
    steady = [stride for stride in strides if stride.is_steady]
    if not steady:
        return None
    by_side = {side: _spreads([stride for stride in steady if stride.side == side]) for side in SIDES}
    left, right = (by_side[side] for side in SIDES)
    symmetry = {
        name: 200.0 * (left[name].mean - right[name].mean) / (left[name].mean + right[name].mean)
        for name in SYMMETRIC
        if name in left and name in right and left[name].mean + right[name].mean > 0
    }
    flies = [stride.flight_s > (stride.double_support_s or 0.0) for stride in steady]
    return GaitFigures(
        len(steady),
        len({stride.bout for stride in steady}),
        _spreads(steady),
        by_side,
        symmetry,
        bool(np.mean(flies) > 0.5),
        float(np.mean([stride.confidence for stride in steady])) * min(1.0, len(steady) / _ENOUGH),
    )


def _spreads(strides: Sequence[Stride]) -> dict[str, Spread]:
    spreads = {}
    for name, figure in FIGURES.items():
        values = [value for value in map(figure, strides) if value is not None]
        if values:
            std = float(np.std(values, ddof=1)) if len(values) > 1 else None
            spreads[name] = Spread(float(np.mean(values)), std, len(values))
    return spreads
