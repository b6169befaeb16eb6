"""Log-likelihood ratios of links between tracklets: motion across the gap, against an unrelated person."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.association.identity.tracklets import Path, Tracklet

# Stretch of a path from which its velocity at an end is measured, and longest time for which it is extrapolated.
_VELOCITY_S, _EXTRAPOLATED_S = 0.4, 0.3
# Standard deviation of a body's position after a gap: at once, for each second, and at most.
_NOISE_M, _WANDER_M_S, _FARTHEST_M = 0.15, 1.2, 3.0
# Standard deviation along each axis of the change of a person's velocity at once and for each second, and of the
# difference of the velocities of unrelated people.
_CHANGE_M_S, _ACCELERATION_M_S2, _UNRELATED_M_S = 0.6, 2.0, 1.2
# Longest absence of a person who is known again. Tracks hold every frame in between.
_LONGEST_ABSENCE_S = 600.0
# Nobody is faster on average, beside the noise of both ends.
_FASTEST_M_S, _FASTEST_NOISE_M = 6.0, 0.6
# Time after which the place says little of the person, and share of bodies that are anywhere even at once.
_FORGOTTEN_S, _ANYWHERE = 2.0, 1e-3
_SMALLEST_AREA_M2 = 10.0
# Log-odds, before any measurement, that a track that goes on at a moment of doubt is of one person (two tracks at an
# encounter count twice); that a person who is lost is found again at once; and that a person who went away is the one
# who comes later.
_STRAIGHT, _FOUND, _RETURNED = 3.0, 2.0, -1.0


class Ends(NamedTuple):
    """Ends of tracklets, as arrays of one row each."""

    time_s: Float[np.ndarray, " n"]  # Time of the first or last frame
    # Position and velocity there
    xyz_m: Float[np.ndarray, "n 3"]
    velocity_m_s: Float[np.ndarray, "n 3"]
    # Track and encounter of the end, see ``Tracklet``
    track: Int[np.ndarray, " n"]
    cut: Int[np.ndarray, " n"]

    def rows(self, index: Int[np.ndarray, "*batch"]) -> "Ends":
        """Some of the ends."""
        return Ends(*(values[index] for values in self))


def first_ends(tracklets: Sequence[Tracklet], paths: Sequence[Path], frame_rate_hz: float) -> Ends:
    """Gather the first frames of all tracklets."""
    reach = max(2, round(_VELOCITY_S * frame_rate_hz))
    frames = [
        np.arange(tracklet.start_frame, min(tracklet.start_frame + reach, tracklet.stop_frame))
        for tracklet in tracklets
    ]
    return _ends(tracklets, paths, frames, [tracklet.cut_before for tracklet in tracklets], 0, frame_rate_hz)


def last_ends(tracklets: Sequence[Tracklet], paths: Sequence[Path], frame_rate_hz: float) -> Ends:
    """Gather the last frames of all tracklets."""
    reach = max(2, round(_VELOCITY_S * frame_rate_hz))
    frames = [
        np.arange(max(tracklet.stop_frame - reach, tracklet.start_frame), tracklet.stop_frame) for tracklet in tracklets
    ]
    return _ends(tracklets, paths, frames, [tracklet.cut_after for tracklet in tracklets], -1, frame_rate_hz)


def _ends(
    tracklets: Sequence[Tracklet],
    paths: Sequence[Path],
    frames: Sequence[Int[np.ndarray, " _"]],
    cuts: Sequence[int],
    end: int,
    frame_rate_hz: float,
) -> Ends:
    fitted = [
        _fit(paths[tracklet.track].at(of_end), (of_end - of_end[end]) / frame_rate_hz)
        for tracklet, of_end in zip(tracklets, frames, strict=True)
    ]
    return Ends(
        np.array([of_end[end] / frame_rate_hz for of_end in frames]),
        np.array([xyz_m for xyz_m, _ in fitted]).reshape(-1, 3),
        np.array([velocity_m_s for _, velocity_m_s in fitted]).reshape(-1, 3),
        np.array([tracklet.track for tracklet in tracklets], int),
        np.array(cuts, int),
    )


def _fit(
    xyz_m: Float[np.ndarray, "frames 3"], time_s: Float[np.ndarray, " frames"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Position and velocity at time 0 by linear least squares; no velocity if it is hardly determined."""
    known = np.isfinite(xyz_m[:, 0])
    xyz_m, time_s = xyz_m[known], time_s[known]
    spread_s = np.ptp(time_s)
    if spread_s < _VELOCITY_S / 2:
        return xyz_m[np.argmin(np.abs(time_s))], np.zeros(3)
    middle_s = time_s.mean()
    centred_s = time_s - middle_s
    velocity_m_s = centred_s @ xyz_m / (centred_s**2).sum()
    return xyz_m.mean(0) - middle_s * velocity_m_s, velocity_m_s


def viewed_area_m2(paths: Sequence[Path]) -> float:
    """Area of the floor on which people were seen."""
    xy_m = np.concatenate([path.xyz_m[:, :2] for path in paths])
    xy_m = xy_m[np.isfinite(xy_m[:, 0])]
    return float(max(_SMALLEST_AREA_M2, np.prod(np.percentile(xy_m, 99, axis=0) - np.percentile(xy_m, 1, axis=0))))


def link_scores(last: Ends, first: Ends, area_m2: float) -> Float[np.ndarray, "*batch"]:
    """Log-likelihood ratio that a person's tracklet is followed by another one: the same person, or not.

    Parameters
    ----------
    last, first
        Ends of the earlier and beginnings of the later tracklets; their arrays are broadcast against each other.

    Returns
    -------
        Ratio of each pair; minus infinity where the later tracklet does not come later, or nobody is as fast.
    """
    gap_s = first.time_s - last.time_s
    ahead_s = np.clip(gap_s / 2, 0.0, _EXTRAPOLATED_S)[..., None]
    between_m = (first.xyz_m - ahead_s * first.velocity_m_s) - (last.xyz_m + ahead_s * last.velocity_m_s)
    squared_m2 = (between_m[..., :2] ** 2).sum(-1)
    apart_m = np.linalg.norm(first.xyz_m - last.xyz_m, axis=-1)
    possible: Bool[np.ndarray, "*batch"] = (
        (gap_s > 0) & (gap_s <= _LONGEST_ABSENCE_S) & (apart_m <= _FASTEST_NOISE_M + _FASTEST_M_S * gap_s)
    )
    variance_m2 = np.minimum(_NOISE_M + _WANDER_M_S * np.maximum(gap_s, 0.0), _FARTHEST_M) ** 2
    near = np.exp(-0.5 * squared_m2 / variance_m2) / (2 * np.pi * variance_m2) * area_m2
    recent = np.exp(-np.maximum(gap_s, 0.0) / _FORGOTTEN_S) * (1 - _ANYWHERE)
    motion = np.log(recent * near + (1 - recent) * np.maximum(near, 1.0))
    change_m_s = np.minimum(_CHANGE_M_S + _ACCELERATION_M_S2 * np.maximum(gap_s, 0.0), _UNRELATED_M_S)
    squared_m2_s2 = ((first.velocity_m_s - last.velocity_m_s)[..., :2] ** 2).sum(-1)
    motion += 2 * np.log(_UNRELATED_M_S / change_m_s) - squared_m2_s2 / 2 * (1 / change_m_s**2 - 1 / _UNRELATED_M_S**2)
    same_cut = (last.cut >= 0) & (last.cut == first.cut)
    prior = _RETURNED + (_FOUND - _RETURNED) * recent
    prior = np.where(same_cut, np.where(last.track == first.track, _STRAIGHT, 0.0), prior)
    return np.where(possible, motion + prior, -np.inf)
