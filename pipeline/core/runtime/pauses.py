"""Pauses between tries of what did not respond."""

import random


class Pauses:
    """Pauses between tries, each up to twice as long as the one before.

    Half of a pause is random, so that workers that were stopped by one outage do not all return at one moment.
    ``first_s`` is the longest first pause, ``longest_s`` the longest of all.
    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self.reset()

    def reset(self) -> None:
        """Begin again with the first pause."""
        self._next_s = self._first_s

    def next_s(self) -> float:
        """Length of the next pause."""
        whole_s = self._next_s
        self._next_s = min(self._longest_s, 2.0 * whole_s)
        return whole_s * random.uniform(0.5, 1.0)  # noqa: S311 - no secret
