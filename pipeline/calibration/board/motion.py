"""Motion of the board: its poses at many instants, and how fast it moves at each of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.calibration.board.bundle import PlacedBoard

# Poses before and after an instant tell the speed if they are at most this far apart.
_MAX_SPAN_S = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class BoardMotion:
    """Board at the instants at which it can be placed, ascending."""

    time_s: Float[np.ndarray, " instants"]
    boards: Sequence[PlacedBoard]  # Numbered alike at all instants
    middle_m: Float[np.ndarray, " 3"]  # Middle of the board, in its frame

    def speed_at(self, time_s: float) -> Float[np.ndarray, " 6"]:
        """Turn about the board's middle and shift of it in a second; 0 where no poses just before and after tell."""
        before = int(np.searchsorted(self.time_s, time_s, "left")) - 1
        after = int(np.searchsorted(self.time_s, time_s, "right"))
        if before < 0 or after >= len(self.time_s) or self.time_s[after] - self.time_s[before] > _MAX_SPAN_S:
            return np.zeros(6)
        span_s = self.time_s[after] - self.time_s[before]
        first, last = self.boards[before].root_from_board, self.boards[after].root_from_board
        turn = Rotation.from_matrix(last.rotation @ first.rotation.T).as_rotvec() / span_s
        middle_m_s = (last.apply(self.middle_m) - first.apply(self.middle_m)) / span_s
        return np.concatenate([turn, middle_m_s])
