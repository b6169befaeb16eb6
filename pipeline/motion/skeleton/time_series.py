"""Joint positions over time: gaps that are filled, overlapping windows of long tracks, and smoothing.

Smoothing leaves gaps, and smooths nothing across a gap.

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
from pipeline.core.progress import OnShare, ignore
from pipeline.geometry.tracks import reproject


def filled_linearly(
    points: Float[np.ndarray, "frames axes"], default: Float[np.ndarray, " axes"]
) -> Float[np.ndarray, "frames axes"]:
    """Replace NaN: linear between known frames, constant at the ends, ``default`` if no frame is known."""
    known = np.flatnonzero(np.isfinite(points).all(-1))
    if len(known) == 0:
        return np.broadcast_to(default, points.shape).copy()
    frames = np.arange(len(points))
    return np.column_stack([np.interp(frames, known, points[known, axis]) for axis in range(points.shape[1])])


def filled_with_body(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Replace NaN where frames are so far apart that the body may be anywhere: joints move with those that are known.

    A gap is filled linearly, and moved as far as the joints that are known in the frame are from where their own
    neighbours in time have them. Joints that are known in no frame stay NaN.
    """
    filled_m = np.full(xyz_m.shape, np.nan)
    beside_m = np.full(xyz_m.shape, np.nan)
    for joint in range(xyz_m.shape[1]):
        known = np.flatnonzero(np.isfinite(xyz_m[:, joint]).all(-1))
        filled_m[:, joint] = filled_linearly(xyz_m[:, joint], np.full(3, np.nan))
        if len(known) > 1:
            before, behind = np.append(known[1], known[:-1]), np.append(known[1:], known[-2])
            weight = np.divide(known - before, behind - before, out=np.zeros(len(known)), where=behind != before)
            at_m = xyz_m[:, joint]
            expected_m = at_m[before] + weight[:, None].clip(0.0, 1.0) * (at_m[behind] - at_m[before])
            beside_m[known, joint] = at_m[known] - expected_m
    moved_m = np.zeros((len(xyz_m), 1, 3))
    some = np.isfinite(beside_m[..., 0]).any(-1)
    moved_m[some, 0] = np.nanmedian(beside_m[some], axis=1)
    return np.where(np.isfinite(xyz_m), xyz_m, filled_m + moved_m)


def filled_relative_to(
    points: Float[np.ndarray, "frames 3"],
    reference: Float[np.ndarray, "frames 3"],
    default: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "frames 3"]:
    """Replace NaN by moving a point with a reference point: the offset between both is filled linearly.

    ``reference`` has no NaN; ``default`` is the offset if the point is known in no frame.
    """
    return reference + filled_linearly(points - reference, default)


def gaps_up_to(known: Bool[np.ndarray, "frames joints"], longest: int) -> Bool[np.ndarray, "frames joints"]:
    """Mark frames in gaps of at most ``longest`` frames between two known frames."""
    inside = np.zeros_like(known)
    frames = np.arange(len(known))
    for joint, is_known in enumerate(known.T):
        last = np.maximum.accumulate(np.where(is_known, frames, -1))
        following = np.minimum.accumulate(np.where(is_known, frames, len(known))[::-1])[::-1]
        inside[:, joint] = (last >= 0) & (following < len(known)) & ~is_known & (following - last <= longest + 1)
    return inside


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
        continues = np.isfinite(step_m).all(-1, keepdims=True)
        step_m = np.where(continues, step_m, 0.0)
        velocity_m_s += _share(_SPEED_HZ, rate_hz) * (step_m * rate_hz - velocity_m_s)
        velocity_m_s[~continues[:, 0]] = 0.0
        cutoff_hz = _REST_HZ + _HZ_PER_M_S * np.linalg.norm(velocity_m_s, axis=-1, keepdims=True)
        followed_m = smoothed[frame - 1] + _share(cutoff_hz, rate_hz) * step_m
        smoothed[frame] = np.where(continues, followed_m, xyz_m[frame])
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
