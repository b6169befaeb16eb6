"""Angles over the cycles of a movement, such as the strides of gait, each stretched to the same length."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

NUM_POINTS = 101
"""Points of a cycle: 0 to 100 percent."""


def normalised_cycles(
    angle_deg: Float[np.ndarray, " frames"], cycles: Iterable[tuple[float, float]]
) -> Float[np.ndarray, "cycles 101"]:
    """Stretch the cycles of an angle to 0 to 100 percent by linear interpolation.

    Parameters
    ----------
    cycles
        First and last row of each cycle, with fractions. Cycles in which the angle is unknown in a frame, or that are
        not inside the frames, are left out.
    """
    frames, found = np.arange(len(angle_deg)), []
    for start, stop in cycles:
        if not 0.0 <= start < stop <= len(angle_deg) - 1:
            continue
        if np.isfinite(angle_deg[int(start) : int(np.ceil(stop)) + 1]).all():
            found.append(np.interp(np.linspace(start, stop, NUM_POINTS), frames, angle_deg))
    return np.array(found).reshape(-1, NUM_POINTS)
