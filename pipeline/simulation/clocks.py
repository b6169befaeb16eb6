"""Frame times of simulated cameras: rates, phases and dropped frames."""

from dataclasses import dataclass

import numpy as np

from pipeline.data.arrays import read_only
from pipeline.data.cameras import FrameTimes


@dataclass(frozen=True, slots=True)
class Clock:
    """Frame rates and phases of the cameras.

    Parameters
    ----------
    frame_rate_hz
        Rate of the output frames, and of synchronised cameras.
    camera_rates_hz
        Rates of the cameras, repeated in turn; empty if all cameras have the common rate.
    random_phase
        Whether each camera starts at a random time within its first period.
    dropped
        Share of frames that are dropped.
    """

    frame_rate_hz: float = 25.0
    camera_rates_hz: tuple[float, ...] = ()
    random_phase: bool = False
    dropped: float = 0.0


def frame_times(clock: Clock, number: int, duration_s: float, rng: np.random.Generator) -> FrameTimes:
    """Draw the times of a camera's frames in [0, duration).

    Parameters
    ----------
    number
        Number of the camera, which selects its rate.
    """
    rate_hz = (
        clock.camera_rates_hz[number % len(clock.camera_rates_hz)] if clock.camera_rates_hz else clock.frame_rate_hz
    )
    phase, fate = rng.random(), rng.random(int(np.ceil(duration_s * rate_hz)) + 1)
    time_s = (np.arange(len(fate)) + (phase if clock.random_phase else 0.0)) / rate_hz
    return FrameTimes(read_only(time_s[(fate >= clock.dropped) & (time_s < duration_s - 1e-9)]))
