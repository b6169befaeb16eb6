"""Feet that stand while people move: found by their ankles, without later frames.

An ankle stands once it is about as low as the person's ankles are when they stand and has hardly moved for a moment. It
stands until its located positions leave that place. ``skeleton.feet`` finds contacts of finished takes.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

# An ankle stands below this height over the person's lowest ankles, and below this speed over so long a time.
_LOW_M, _SLOW_M_S, _WHILE_S = 0.08, 0.25, 0.2
# Heights of ankles that are kept for the lowest ones, how often, and the quantile that is their level.
_MOST_HEIGHTS, _HEIGHT_EVERY_S, _LEVEL_SHARE = 200, 0.1, 0.1
# Distance of the mean of the last positions from the place of a foot at which it leaves it; one and a half sigmas of a
# detector's noise. One position leaves it at the larger distance.
_LEAVES_M, _NUM_LAST, _LEAVES_AT_ONCE_M = 0.025, 3, 0.06
_LONGEST_UNSEEN_S = 0.5
# Positions whose mean is the place of a foot.
_MOST_MEAN = 100
_NOWHERE_M = np.full(3, np.nan)


@dataclass(slots=True, eq=False)
class _Foot:
    """Recent positions of an ankle, and the place where it stands."""

    recent: deque[tuple[float, Float[np.ndarray, " 3"]]] = field(default_factory=deque)
    place_m: Float[np.ndarray, " 3"] | None = None
    num_mean: int = 0
    last: deque[Float[np.ndarray, " 3"]] = field(default_factory=lambda: deque(maxlen=_NUM_LAST))
    seen_s: float = -np.inf


class StandingFeet:
    """Places of a person's feet that stand, left and right."""

    def __init__(self) -> None:
        self._feet = (_Foot(), _Foot())
        self._heights_m: deque[float] = deque(maxlen=_MOST_HEIGHTS)
        self._height_s = -np.inf

    def forget(self) -> None:
        """Forget where feet are: the person was not seen for a while."""
        self._feet = (_Foot(), _Foot())

    @property
    def places_m(self) -> Float[np.ndarray, "2 3"]:
        """Places of the ankles of standing feet, world positions in metres; NaN for a foot that does not stand."""
        return np.array([_NOWHERE_M if foot.place_m is None else foot.place_m for foot in self._feet])

    def update(self, time_s: float, located_m: Float[np.ndarray, "2 3"]) -> None:
        """Take the located ankles of an instant (metres, NaN where unknown)."""
        if time_s - self._height_s >= _HEIGHT_EVERY_S:
            self._heights_m.extend(located_m[np.isfinite(located_m[:, 2]), 2].tolist())
            self._height_s = time_s
        for foot, ankle_m in zip(self._feet, located_m, strict=True):
            if np.isfinite(ankle_m).all():
                foot.seen_s = time_s
                self._see(foot, time_s, ankle_m)
            elif time_s - foot.seen_s > _LONGEST_UNSEEN_S:
                foot.place_m = None
                foot.recent.clear()

    def _see(self, foot: _Foot, time_s: float, ankle_m: Float[np.ndarray, " 3"]) -> None:
        foot.recent.append((time_s, ankle_m))
        while time_s - foot.recent[0][0] > _WHILE_S + 1e-6:
            foot.recent.popleft()
        if foot.place_m is None:
            self._stand(foot, time_s)
            return
        foot.last.append(ankle_m)
        apart_m = float(np.linalg.norm(ankle_m - foot.place_m))
        is_off = len(foot.last) == _NUM_LAST and np.linalg.norm(np.mean(foot.last, 0) - foot.place_m) > _LEAVES_M
        if is_off or apart_m > _LEAVES_AT_ONCE_M:
            foot.place_m = None
            foot.recent.clear()
            return
        foot.num_mean = min(foot.num_mean + 1, _MOST_MEAN)
        foot.place_m = foot.place_m + (ankle_m - foot.place_m) / foot.num_mean

    def _stand(self, foot: _Foot, time_s: float) -> None:
        """Let a foot stand if it is low and has been slow."""
        first_s = foot.recent[0][0]
        if time_s - first_s < 0.75 * _WHILE_S:
            return
        ankles_m = np.array([ankle_m for _, ankle_m in foot.recent])
        half = len(ankles_m) // 2
        if half == 0:
            return
        before_m, after_m = ankles_m[:half].mean(0), ankles_m[-half:].mean(0)
        speed_m_s = float(np.linalg.norm(after_m - before_m)) / ((time_s - first_s) * 0.5)
        if speed_m_s >= _SLOW_M_S:
            return
        level_m = float(np.quantile(np.array(self._heights_m), _LEVEL_SHARE))
        mean_m = ankles_m.mean(0)
        if mean_m[2] - level_m < _LOW_M:
            foot.place_m, foot.num_mean = mean_m, len(ankles_m)
            foot.last.clear()
