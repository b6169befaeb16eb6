"""Keys of joints: how far a joint is moved in the frames around its keys."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.core.options.edits import Correction, KeyJoint

REACH_S = 0.5
"""Time before the first and after the last correction of a range in which the motion passes to the uncorrected one."""

# Standard deviation with which a person places a joint by hand.
_PLACED_M = 0.01


def reach_frames(frame_rate_hz: float) -> int:
    """Number of frames before and after corrections at which the motion is as without them, at least 1."""
    return max(int(REACH_S * frame_rate_hz), 1)


def rows_between(start_frame: int, stop_frame: int, first: int, num_frames: int) -> slice:
    """Rows of a track, which begins at the frame ``first``, within frames."""
    start, stop = np.clip((start_frame - first, stop_frame - first), 0, num_frames).tolist()
    return slice(start, stop)


def keys_by_joint(
    corrections: Sequence[Correction], start_frame: int, num_frames: int
) -> Mapping[str, Mapping[int, Float[np.ndarray, " 3"]]]:
    """Places of keys within a track by joint and row, in metres; of two keys of a joint in a frame the later counts."""
    places: dict[str, dict[int, np.ndarray]] = {}
    for correction in corrections:
        if isinstance(correction, KeyJoint) and 0 <= correction.frame - start_frame < num_frames:
            of_joint = places.setdefault(correction.joint, {})
            of_joint[correction.frame - start_frame] = np.array(correction.place_m)
    return places


def displacement_m(
    rows: Sequence[int],
    moved_m: Float[np.ndarray, "keys 3"],
    is_measured: Bool[np.ndarray, " frames"],
    frame_rate_hz: float,
) -> Float[np.ndarray, "frames 3"]:
    """Displacement of a joint in all frames, from its displacements at keys; NaN in frames that no key reaches.

    Between keys that are less than a second apart it is a monotone cubic (Fritsch and Carlson 1980), which does not
    overshoot. Before and after them it rises from and falls to zero within half a second. A key in frames in which the
    joint was not measured says nothing against the frames in which it was: there it ends.

    ``rows``: frames of the keys, ascending. ``is_measured``: whether the joint was measured.
    """
    from scipy.interpolate import PchipInterpolator  # noqa: PLC0415 - slow to import, and seldom needed

    reach = reach_frames(frame_rate_hz)
    result = np.full((len(is_measured), 3), np.nan)
    kept = {row + step: np.zeros(3) for row in rows for step in _to_measured(is_measured, row, reach)}
    at = kept | dict(zip(rows, moved_m, strict=True))
    for group in np.split(np.array(rows), np.flatnonzero(np.diff(rows) >= 2 * reach) + 1):
        first, last = int(group[0]) - reach, int(group[-1]) + reach
        # Two zeros at each end make the curve flat there.
        ends = {row: np.zeros(3) for row in (first - 1, first, last, last + 1)}
        inner = {row: by_m for row, by_m in at.items() if first < row < last}
        knots = sorted((ends | inner).items())
        frames = np.arange(max(first, 0), min(last + 1, len(is_measured)))
        curve = PchipInterpolator([row for row, _ in knots], [by_m for _, by_m in knots])
        result[frames] = curve(frames)
    return result


def _to_measured(is_measured: Bool[np.ndarray, " frames"], row: int, reach: int) -> list[int]:
    """Steps from a frame without a measurement to the last and to the next one with it, within a reach."""
    if is_measured[row]:
        return []
    steps = np.flatnonzero(is_measured) - row
    before, after = steps[(steps < 0) & (steps > -reach)], steps[(steps > 0) & (steps < reach)]
    return [*before[-1:].tolist(), *after[:1].tolist()]


def key_uncertainty_m(
    rows: Sequence[int],
    usual_m: float,
    free_m: Float[np.ndarray, " frames"],
    moved_m: Float[np.ndarray, "frames 3"],
) -> Float[np.ndarray, " frames"]:
    """Standard deviation of a keyed joint in metres: of the hand at keys, growing with the time to the nearest key.

    Away from keys, a joint may have accelerated as usual (``usual_m``, the second difference between frames); it is
    never less certain than it was without keys (``free_m``), with its whole displacement as an error.
    """
    frames = np.arange(len(free_m))
    away = np.abs(frames[:, None] - np.array(rows)).min(1)
    grown_m = np.hypot(_PLACED_M, usual_m * away**2 / 2)
    return np.asarray(np.fmin(grown_m, np.hypot(free_m, np.linalg.norm(moved_m, axis=-1))))
