"""Frame rates as fractions, measured from frame times that files round.

Cameras run at whole rates (25 Hz) or at NTSC rates (30000/1001 Hz). Files round times to ticks of a clock, and programs
compute with floats, so that a mean rate is 29.970029970029973 or 59.99 Hz. A measured rate is replaced by the nearest
usual rate if the times are not precise enough to distinguish both.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from pipeline.core.errors import Problem
from pipeline.core.problems.finding_codes import FRAME_RATE_VARIES, FRAMES_DROPPED, FRAMES_TOO_CLOSE

DEFAULT_RATE = Fraction(25)
"""Rate of a camera with a single frame, in frames a second."""

# Largest difference from the usual interval, as a share of it, of an interval that is not a gap. Intervals of 2 and 3
# ticks are both usual; the interval of a dropped frame is a gap.
_EVEN = 0.6
# Limit on the denominators of rates that are not usual: 27.3 Hz and not 27.299999999999997. It moves a rate by less
# than 1e-6 Hz, which is two milliseconds in twelve hours at 25 Hz.
_MAX_DENOMINATOR = 10**6
# Largest change by snapping, as a share of the rate. Jitter and many gaps together would allow larger changes.
_MAX_CHANGE = 0.01


def nearest_usual_rate(rate_hz: float | Fraction) -> Fraction:
    """Nearest rate of the forms n and n * 1000/1001 Hz, n = 1, 2, 3, ..."""
    whole = Fraction(max(1, round(rate_hz)))
    ntsc = Fraction(1000 * max(1, round(rate_hz * 1001 / 1000)), 1001)
    return min(whole, ntsc, key=lambda usual: abs(usual - Fraction(rate_hz)))


def snapped(rate: Fraction, precision_hz: Fraction) -> Fraction:
    """Replace a rate by the nearest usual rate if both differ by no more than ``precision_hz``.

    Snapping is idempotent.

    >>> snapped(Fraction("29.96"), Fraction("0.02")), snapped(Fraction("27.3"), Fraction("0.02"))
    (Fraction(30000, 1001), Fraction(273, 10))
    """
    usual = nearest_usual_rate(rate)
    return usual if abs(usual - rate) <= precision_hz else rate


def without_rounding(rate_hz: float) -> Fraction:
    """Fraction that a float stands for: 30000/1001 for 29.970029970029973."""
    return Fraction(rate_hz).limit_denominator(_MAX_DENOMINATOR)


def measured_rate(time_s: NDArray[np.float64]) -> Fraction | None:
    """Mean rate over all intervals within 60 % of the usual interval, snapped within the precision of the times.

    Regular times that are rounded to ticks have intervals that differ by one tick. So the duration of a run of frames
    without a gap has an error of at most one tick. The error of the mean interval is the sum over all runs, divided by
    the number of intervals. Jitter is treated as rounding. Times ascend, in seconds, at least one. The rate in frames a
    second is 25 for a single frame, ``None`` where frames share their times.
    """
    intervals_s = np.sort(np.diff(time_s))
    if not len(intervals_s):
        return DEFAULT_RATE
    # The lower median, not the mean of two: 24 Hz on a clock of 60 Hz has intervals of 2 and 3 ticks.
    usual_s = intervals_s[(len(intervals_s) - 1) // 2]
    even_s = intervals_s[np.abs(intervals_s - usual_s) <= _EVEN * usual_s]
    mean_s = float(np.mean(even_s))
    # Intervals of a damaged file may be so short that the rate exceeds the range of floats.
    if mean_s < np.finfo(np.float64).tiny:
        return None
    num_runs = 1 + len(intervals_s) - len(even_s)
    tick_s = max(float(even_s[-1] - even_s[0]), float(np.spacing(np.abs(time_s).max())))
    change = min(tick_s * num_runs / (len(even_s) * mean_s), _MAX_CHANGE)
    rate = without_rounding(1.0 / mean_s)
    return snapped(rate, Fraction(change) * rate)


def measured_rate_hz(time_s: NDArray[np.float64]) -> float:
    """Rate of ``measured_rate`` as a float, for files and arithmetic; infinity where frames share their times."""
    rate = measured_rate(time_s)
    return math.inf if rate is None else float(rate)


# An interval of 1.6 usual ones or more is a gap, one of 0.4 or less is too short; as ``frame_rate`` has it.
# With more uneven intervals the rate varies on purpose, and a usual interval means nothing.
_MAX_UNEVEN = 0.2
_SHOWN_TIMES = 5

OF_TIMES = frozenset({"frame_rate_varies", "frames_dropped", "frames_too_close"})
"""Codes of the warnings of ``uneven_times``."""

_HINT = "The times of the frames are right; for fast motion, record again with a camera that keeps its rate."


def uneven_times(time_s: NDArray[np.float64]) -> list[Problem]:
    """Warn of gaps between frames, of frames too close to each other, or of a rate that varies.

    Times are since the first frame, ascending.
    """
    intervals_s = np.diff(time_s)
    if len(intervals_s) < 2:
        return []
    usual_s = float(np.sort(intervals_s)[(len(intervals_s) - 1) // 2])
    is_gap = intervals_s > (1 + _EVEN) * usual_s
    is_short = intervals_s < (1 - _EVEN) * usual_s
    share = float((is_gap | is_short).mean())
    if share > _MAX_UNEVEN:
        message = f"The frame rate varies: {share:.0%} of the intervals between frames are far from the usual one."
        return [Problem(FRAME_RATE_VARIES, message, hint="A constant rate shows fast motion better.")]
    warnings = []
    if is_gap.any():
        dropped = int((np.rint(intervals_s[is_gap] / usual_s) - 1).sum())
        begins_s = time_s[:-1][is_gap]
        message = f"{_frames(dropped, 'is', 'are')} missing, {_places(begins_s)}; the longest gap is {{:.3g}} s."
        warnings.append(Problem(FRAMES_DROPPED, message.format(float(intervals_s.max())), hint=_HINT))
    if is_short.any():
        message = f"{_frames(int(is_short.sum()), 'follows', 'follow')} the one before at once, "
        warnings.append(Problem(FRAMES_TOO_CLOSE, message + _places(time_s[1:][is_short]) + ".", hint=_HINT))
    return warnings


def _frames(number: int, singular: str, plural: str) -> str:
    return f"1 frame {singular}" if number == 1 else f"{number} frames {plural}"


def _places(time_s: NDArray[np.float64]) -> str:
    shown: Sequence[str] = [f"{frame_s:.2f}" for frame_s in time_s[:_SHOWN_TIMES]]
    more = len(time_s) - len(shown)
    return f"at {', '.join(shown)} s" + (f" and {more} more times" if more else "")
