"""A live capture in progress."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.data.cameras import Camera
from pipeline.joints import JointSet
from pipeline.live.records import LiveCounts, LiveInstant
from pipeline.live.settings import LiveSettings


class LiveCapture:
    """Live capture in progress."""

    def __init__(self, cameras: Sequence[Camera], joints: JointSet, settings: LiveSettings) -> None: ...

    def push(
        self,
        camera: int | str,
        time_s: float,
        points_px: Float[np.ndarray, "people joints 2"],
        score: Float[np.ndarray, "people joints"],
    ) -> list[LiveInstant]:
        """Take a frame of a camera; return the instants that became final by it, in time order."""
        raise NotImplementedError

    def flush(self) -> list[LiveInstant]:
        """Process the frames that wait; return the instants that became final."""
        raise NotImplementedError

    @property
    def counts(self) -> LiveCounts:
        """Numbers of frames so far."""
        raise NotImplementedError
