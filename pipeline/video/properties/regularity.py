"""Dropped frames and frames at almost the same time, found from the times of a video's frames.

Phones drop frames while they are busy. The times of the others stay true.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.core.errors import Problem
from pipeline.core.problems.findings import FRAME_RATE_VARIES, FRAMES_DROPPED, FRAMES_TOO_CLOSE

# An interval of 1.6 usual ones or more is a gap, one of 0.4 or less is too short; as ``frame_rate`` has it.
_EVEN = 0.6
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
