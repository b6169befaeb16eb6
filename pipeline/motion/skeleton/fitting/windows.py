"""Overlapping windows of long tracks, so that memory does not grow with the length of a track."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from pipeline.core.progress import OnShare, ignore

_WINDOW_FRAMES, _OVERLAP_FRAMES = 600, 60


def windows(num_frames: int, overlap: int = _OVERLAP_FRAMES, on_share: OnShare = ignore) -> Iterator[slice]:
    """Ranges of frames to process at once; ``on_share`` is called with the progress after each window."""
    step = _WINDOW_FRAMES - overlap
    for start in range(0, max(num_frames - overlap, 1), step):
        stop = min(start + _WINDOW_FRAMES, num_frames)
        yield slice(start, stop)
        on_share(stop / max(num_frames, 1))


class Blend:
    """Join the values of overlapping windows, blended linearly in the overlaps.

    ``result``, the values of all frames, is written in place.
    """

    def __init__(self, result: Float[np.ndarray, "frames *values"]) -> None:
        self._result = result
        self._done = 0

    def add(self, rows: slice, values: Float[np.ndarray, "rows *values"]) -> None:
        """Add the values of a window; call in the order of ``windows``."""
        overlap = self._done - rows.start
        before, after = self._result[rows.start : self._done], values[:overlap]
        share = (np.arange(1, overlap + 1) / (overlap + 1)).reshape(-1, *(1,) * (values.ndim - 1))
        known = np.where(np.isnan(after), before, np.where(np.isnan(before), after, before + share * (after - before)))
        self._result[rows.start : self._done] = known
        self._result[self._done : rows.stop] = values[overlap:]
        self._done = rows.stop
