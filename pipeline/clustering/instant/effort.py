"""Limits on the work for one instant, so that its time and memory are bounded whatever the cameras saw.

The limits lie several times above what the simulated scenes need: seven people in 31 cameras, sixteen in 28. Beyond a
limit the least certain part of a problem is left out, and the instant counts as approximate.
"""

from dataclasses import dataclass

MAX_CANDIDATES = 128
"""Candidates of a joint in a view."""

MAX_PAIRS = 100_000
"""Pairs of a joint's candidates whose rays are intersected; four views of 128 people have fewer."""

MAX_HYPOTHESES = 12_000
"""Hypotheses of a joint."""

MAX_NEIGHBOURS = 8_000_000
"""Pairs of hypotheses closer than DBSCAN's eps."""

MAX_JOINTS = 512
"""Joints of one kind."""

MAX_DENSE = 2**24
"""Entries of a matrix over joints of all kinds; beyond it, one matrix is made for each kind."""

_MAX_STEPS = 1_000_000
_STEPS_A_ROUND = 100


@dataclass(slots=True)
class Effort:
    """Work on one instant.

    Parameters
    ----------
    is_exact
        Whether no limit was met yet.
    """

    is_exact: bool = True
    _left: int = _MAX_STEPS

    def allows(self, size: int, most: int) -> bool:
        """Return whether a size is within a limit; beyond it the instant is approximate."""
        self.is_exact &= size <= most
        return size <= most

    def allows_round(self, num_hypotheses: int) -> bool:
        """Return whether the remaining effort allows a search for the densest hypotheses, and spend it if so."""
        self._left -= num_hypotheses + _STEPS_A_ROUND
        return self.allows(-self._left, 0)
