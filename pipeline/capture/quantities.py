"""Allowed ranges of the quantities in input files, far wider than real values.

Within these ranges no product or square in the geometry overflows. The readers refuse numbers outside.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Quantity:
    """Range of values with a unit; the limits are allowed.

    >>> str(Quantity(1, 20_000, "pixels"))
    '1 to 20,000 pixels'
    """

    low: int | float
    high: int | float
    unit: str

    def holds(self, values: float | np.ndarray, tolerance: float = 0.0) -> bool:
        """Return whether all values are in the range; NaN is not.

        Parameters
        ----------
        tolerance
            Share of a limit by which values may exceed it, for computed values, which are rounded.

        Examples
        --------
        >>> rate_hz = 1000.0000000000002
        >>> FRAME_RATE_HZ.holds(rate_hz), FRAME_RATE_HZ.holds(rate_hz, tolerance=1e-3)
        (False, True)
        """
        array = np.asarray(values, dtype=np.float64)
        low, high = self.low - abs(self.low) * tolerance, self.high + abs(self.high) * tolerance
        return bool(((array >= low) & (array <= high)).all())

    def __str__(self) -> str:
        """Range and unit as messages show them."""
        return f"{self.low:,.10g} to {self.high:,.10g} {self.unit}".strip()


SIDE_PX = Quantity(1, 20_000, "pixels")
FOCAL_LENGTH_PX = Quantity(1, 1e6, "pixels")
PRINCIPAL_POINT_PX = Quantity(-1e5, 1e5, "pixels")
SKEW_PX = Quantity(-1e5, 1e5, "pixels")
# Coefficients grow as the angle of view shrinks: a telephoto lens, with r = 0.05 at the edge, may have a k3 of 600,000.
DISTORTION = Quantity(-1e9, 1e9, "")
ROTATION_VECTOR_RAD = Quantity(-100, 100, "radians")
# In the unit of the file: 10 km for millimetres.
TRANSLATION = Quantity(-1e7, 1e7, "")
KEYPOINT_PX = Quantity(-1e6, 1e6, "pixels")
FRAME_RATE_HZ = Quantity(1, 1000, "Hz")
# Tolerance of rates that are computed from times, which files round.
FRAME_RATE_TOLERANCE = 1e-3
# Time of a keypoint frame in a file of timestamps. A larger number is a date, not a time since the start.
TIME_S = Quantity(0, 1e6, "s")
# Time of a video's first frame, on the clock that all cameras share.
OFFSET_S = Quantity(-86_400, 86_400, "s")
# Duration of a session, from its first frame to its last.
DURATION_S = Quantity(0, 43_200, "s")
