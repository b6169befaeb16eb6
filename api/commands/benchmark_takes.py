"""What the benchmarks share: long takes out of short ones, and how much memory there was."""

import resource

import numpy as np


def to_and_fro(values: np.ndarray, num_frames: int) -> np.ndarray:
    """A take that goes on as itself backwards, and again."""
    period = np.concatenate([values, values[::-1]])
    return np.concatenate([period] * -(-num_frames // len(period)))[:num_frames]


def peak_rss_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
