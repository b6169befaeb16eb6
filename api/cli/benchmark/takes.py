"""Long takes made from short takes, and peak memory, for the benchmarks."""

import resource
from dataclasses import replace

import numpy as np

from pipeline.data.people import Observations, Track3D


def to_and_fro(values: np.ndarray, num_frames: int) -> np.ndarray:
    """Repeat values forwards and backwards along the first axis, up to a number of frames."""
    period = np.concatenate([values, values[::-1]])
    return np.concatenate([period] * -(-num_frames // len(period)))[:num_frames]


def longer_track(track: Track3D, num_frames: int) -> Track3D:
    """Repeat a track forwards and backwards (``to_and_fro``)."""
    return replace(
        track,
        xyz_m=to_and_fro(track.xyz_m, num_frames),
        score=to_and_fro(track.score, num_frames),
        source=to_and_fro(track.source, num_frames),
        error_px=to_and_fro(track.error_px, num_frames),
        views=to_and_fro(track.views, num_frames),
        uncertainty_m=None if track.uncertainty_m is None else to_and_fro(track.uncertainty_m, num_frames),
    )


def longer_observations(seen: Observations, num_frames: int) -> Observations:
    """Repeat the observations of a track forwards and backwards (``to_and_fro``)."""
    return replace(seen, points_px=to_and_fro(seen.points_px, num_frames), score=to_and_fro(seen.score, num_frames))


def peak_rss_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
