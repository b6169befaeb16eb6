"""Limits on the work at one instant, which bound its time and memory for any input.

The limits are several times above the needs of the simulated scenes (seven people in 31 cameras, sixteen in 28). Beyond
a limit the least certain part of a problem is left out, and the instant counts as approximate.
"""

from dataclasses import dataclass

MAX_CANDIDATES = 128
"""Most candidates of a joint in a view."""

MAX_PAIRS = 100_000
"""Most pairs of a joint's candidates that are triangulated; four views of 128 people have fewer."""

MAX_HYPOTHESES = 12_000
"""Most hypotheses of a joint."""

MAX_NEIGHBOURS = 8_000_000
"""Most pairs of hypotheses closer than DBSCAN's eps."""

MAX_JOINTS = 512
"""Most 3D joints of one kind."""

MAX_BODIES = 1024
"""Most bodies of all views that are matched as a whole."""

MAX_REPAIRS = 100_000
"""Most views of changed poses that are tried in a round of the repair of people."""

MAX_DENSE = 2**24
"""Most entries of a matrix over joints of all kinds; beyond it, a matrix is made for each kind."""

_MAX_STEPS = 1_000_000
_STEPS_A_ROUND = 100


@dataclass(slots=True)
class WorkLimits:
    """Account of the work at one instant."""

    is_exact: bool = True  # True if no limit was exceeded so far
    _left: int = _MAX_STEPS

    def allows(self, size: int, most: int) -> bool:
        """Return whether a size is within a limit; if not, the instant becomes approximate."""
        self.is_exact &= size <= most
        return size <= most

    def allows_round(self, num_hypotheses: int) -> bool:
        """Return whether the remaining effort allows a search for the densest hypotheses, and spend it if so."""
        self._left -= num_hypotheses + _STEPS_A_ROUND
        return self.allows(-self._left, 0)
