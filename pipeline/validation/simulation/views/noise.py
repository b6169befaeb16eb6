"""Random processes of detector noise: correlated over frames, in runs, and heavy-tailed."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.signal import lfilter
from scipy.stats import norm


def lasting_noise(
    rng: np.random.Generator, shape: tuple[int, ...], memory_frames: float
) -> Float[np.ndarray, "*batch frames"]:
    """Gaussian noise of unit variance along the last axis: a stationary autoregressive process of first order.

    Frames are the last axis of ``shape``. In ``memory_frames`` the correlation falls to 1 / e; 0 for independent
    frames.
    """
    white = rng.standard_normal(shape)
    if memory_frames <= 0 or shape[-1] == 0:
        return white
    rho = np.exp(-1 / memory_frames)
    gain = np.sqrt(1 - rho**2)
    # The state before the first frame has the stationary distribution, too.
    before = rho * rng.standard_normal((*shape[:-1], 1))
    noise, _ = lfilter([gain], [1.0, -rho], white, axis=-1, zi=before)
    return np.asarray(noise)


def lasting_events(
    rng: np.random.Generator, shape: tuple[int, ...], rate: float, memory_frames: float
) -> Bool[np.ndarray, "*batch frames"]:
    """Draw events that are true in a share ``rate`` of all frames, in runs; see ``lasting_noise``."""
    return lasting_noise(rng, shape, memory_frames) > norm.isf(rate)


def heavy_tailed(
    rng: np.random.Generator, shape: tuple[int, ...], degrees_of_freedom: float
) -> Float[np.ndarray, "*batch"]:
    """Independent Student's t noise, scaled to unit variance."""
    return rng.standard_t(degrees_of_freedom, shape) / np.sqrt(degrees_of_freedom / (degrees_of_freedom - 2))
