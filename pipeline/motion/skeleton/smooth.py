"""Smoothing of joint positions over time. Gaps stay gaps, and nothing is smoothed across a gap.

*Butterworth*: low-pass of fourth order without delay, by a second-order filter in both directions. The cutoff of each
pass is raised so that both together have the requested cutoff (Winter, "Biomechanics and motor control of human
movement", section 2.2.4.4).

*One-euro*: low-pass with a cutoff that increases with speed, so that a still hand does not tremble and a fast hand does
not lag (Casiez, Roussel and Vogel, "1 euro filter", CHI 2012). It uses past frames only, like a live preview.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, Timebase
from pipeline.core.data.people import Observations, Track3D
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.tracks import reproject

_ORDER = 2
# Factor by which two passes of a filter lower its cutoff.
_BOTH_PASSES = (np.sqrt(2.0) - 1.0) ** (1.0 / (2 * _ORDER))

# Cutoff of a joint at rest, increase of the cutoff per m/s, and cutoff of the speed itself. In simulation, the loss of
# accuracy by the lag then equals the gain by smoothing.
_REST_HZ, _HZ_PER_M_S, _SPEED_HZ = 3.0, 8.0, 2.0

_Filter = Callable[[Float[np.ndarray, "frames joints 3"]], Float[np.ndarray, "frames joints 3"]]


def smooth_track(
    track: Track3D,
    seen: Observations,
    cameras: Sequence[Camera],
    timebase: Timebase,
    config: ReconstructionConfig,
) -> Track3D:
    """Smooth each joint of a person by itself, and compute the reprojection error again.

    For methods other than ``butterworth`` and ``one-euro`` the track is returned unchanged.
    """
    rate_hz = timebase.frame_rate_hz
    filters: dict[str, _Filter] = {
        "butterworth": partial(butterworth, rate_hz=rate_hz, cutoff_hz=config.cutoff_hz),
        "one-euro": partial(one_euro, rate_hz=rate_hz),
    }
    low_pass = filters.get(config.smoothing)
    if low_pass is None:
        return track
    xyz_m = low_pass(track.xyz_m)
    error_px, _, _ = reproject(cameras, xyz_m, seen.points_px, seen.score)
    return replace(track, xyz_m=read_only(xyz_m), error_px=read_only(error_px))


def butterworth(
    xyz_m: Float[np.ndarray, "frames joints 3"], rate_hz: float, cutoff_hz: float
) -> Float[np.ndarray, "frames joints 3"]:
    """Low-pass of fourth order without delay; NaN stays NaN, and nothing is filtered across it."""
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415 - slow to import, and seldom needed

    # The bilinear transform of the digital filter warps frequencies by the tangent.
    raised_hz = np.arctan(np.tan(np.pi * cutoff_hz / rate_hz) / _BOTH_PASSES) * rate_hz / np.pi
    sections = butter(_ORDER, raised_hz, fs=rate_hz, output="sos")
    smoothed = xyz_m.copy()
    for joint in range(xyz_m.shape[1]):
        for run in _runs(np.isfinite(xyz_m[:, joint]).all(-1)):
            # The run is mirrored at its ends for a period of the cutoff, so that the filter settles.
            num_mirrored = min(run.stop - run.start - 1, max(1, round(rate_hz / cutoff_hz)))
            smoothed[run, joint] = sosfiltfilt(sections, xyz_m[run, joint], axis=0, padlen=num_mirrored)
    return smoothed


def one_euro(xyz_m: Float[np.ndarray, "frames joints 3"], rate_hz: float) -> Float[np.ndarray, "frames joints 3"]:
    """Low-pass that follows fast movements; NaN stays NaN, and the filter restarts after it."""
    smoothed = xyz_m.copy()
    velocity_m_s = np.zeros(xyz_m.shape[1:])
    for frame in range(1, len(xyz_m)):
        step_m = xyz_m[frame] - smoothed[frame - 1]
        goes_on = np.isfinite(step_m).all(-1, keepdims=True)
        step_m = np.where(goes_on, step_m, 0.0)
        velocity_m_s += _share(_SPEED_HZ, rate_hz) * (step_m * rate_hz - velocity_m_s)
        velocity_m_s[~goes_on[:, 0]] = 0.0
        cutoff_hz = _REST_HZ + _HZ_PER_M_S * np.linalg.norm(velocity_m_s, axis=-1, keepdims=True)
        followed_m = smoothed[frame - 1] + _share(cutoff_hz, rate_hz) * step_m
        smoothed[frame] = np.where(goes_on, followed_m, xyz_m[frame])
    return smoothed


def _share(cutoff_hz: float | Float[np.ndarray, "*batch"], rate_hz: float) -> float | Float[np.ndarray, "*batch"]:
    """Weight of a new value in an exponential low-pass."""
    return 1.0 / (1.0 + rate_hz / (2 * np.pi * cutoff_hz))


def _runs(known: Bool[np.ndarray, " frames"]) -> Iterator[slice]:
    """Runs of at least two known frames."""
    borders = np.flatnonzero(np.diff(known.astype(np.int8), prepend=0, append=0))
    for start, stop in borders.reshape(-1, 2).tolist():
        if stop - start >= 2:
            yield slice(start, stop)
