"""Times of a camera's frames in few numbers: knots between which times are interpolated."""

import numpy as np
from jaxtyping import Float

TOLERANCE_S = 1e-3
"""Largest difference of an interpolated time; videos of some containers are rounded to 1 ms anyway."""


def knots(times_s: Float[np.ndarray, "frames clocks"]) -> list[int]:
    """Frames between which the times of all others are interpolated linearly, within ``TOLERANCE_S``.

    A steady camera has two knots. Each pause and each change of the rate adds some (Douglas and Peucker 1973).

    Parameters
    ----------
    times_s
        Ascending times of a camera's frames on one clock or several, at least one frame.

    Returns
    -------
        Frame numbers, ascending, with the first and the last one.
    """
    found = {0, len(times_s) - 1}
    open_parts = [(0, len(times_s) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        share = (np.arange(first, last + 1) - first)[:, None] / max(1, last - first)
        straight_s = times_s[first] + share * (times_s[last] - times_s[first])
        off_s = np.abs(times_s[first : last + 1] - straight_s).max(1)
        worst = first + int(off_s.argmax())
        if off_s[worst - first] > TOLERANCE_S:
            found.add(worst)
            open_parts += [(first, worst), (worst, last)]
    return sorted(found)
