"""Tracklets: pieces of tracks over which identity is not in doubt, the moments between them, and their links.

A link has a log-likelihood ratio: motion across the gap, against an unrelated person.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.arrays import mean_known
from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet
from pipeline.core.runtime import large_arrays

_TORSO = "left_shoulder", "right_shoulder", "left_hip", "right_hip"
# A person who was located in no frame for longer may be another person afterwards.
_LONGEST_GAP_S = 0.2
# Two people who are nearer to each other than this may have been exchanged.
_REACH_M = 0.4
# A body whose trunk is farther away a frame later, beyond this speed, is another body.
_JUMP_M, _FASTEST_M_S = 0.3, 7.0


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Way of a track's trunk."""

    start_frame: int  # Output frame of the first row
    # Mean position of the trunk's joints, of all joints if none of these is known; NaN where no joint is known
    xyz_m: Float[np.ndarray, "frames 3"]

    @property
    def stop_frame(self) -> int:
        """Frame after the last one."""
        return self.start_frame + len(self.xyz_m)

    def at(self, frames: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Positions at some output frames, NaN outside of the track."""
        inside = (frames >= self.start_frame) & (frames < self.stop_frame)
        rows = np.clip(frames - self.start_frame, 0, len(self.xyz_m) - 1)
        return np.where(inside[:, None], self.xyz_m[rows], np.nan)


def make_path(track: Track3D, joints: JointSet) -> Path:
    """Way of a track's trunk; see ``Path``."""
    torso = [joints.index(name) for name in _TORSO if name in joints.names]
    way_m = np.empty((track.num_frames, 3))
    for rows in large_arrays.blocks(track.num_frames):
        trunk_m = mean_known(track.xyz_m[rows, torso], 1)
        way_m[rows] = np.where(np.isfinite(trunk_m), trunk_m, mean_known(track.xyz_m[rows], 1))
    return Path(track.start_frame, way_m)


@dataclass(frozen=True, slots=True)
class Tracklet:
    """Consecutive frames of a track."""

    track: int  # Position of the track among the session's tracks
    # First output frame, and the one after the last
    start_frame: int
    stop_frame: int
    # Numbers of the moments at which it was cut, -1 where the track itself begins or ends, or had a gap
    cut_before: int = -1
    cut_after: int = -1


def cut_at_gaps(paths: Sequence[Path], frame_rate_hz: float) -> list[Tracklet]:
    """Cut tracks where the person was not located for a while, and where the body jumped."""
    return [
        Tracklet(number, path.start_frame + first, path.start_frame + last + 1)
        for number, path in enumerate(paths)
        for first, last in _runs(path, frame_rate_hz)
    ]


def _runs(path: Path, frame_rate_hz: float) -> Iterator[tuple[int, int]]:
    """First and last rows of the pieces of a path."""
    rows = np.flatnonzero(np.isfinite(path.xyz_m[:, 0]))
    if not len(rows):
        return
    passed_s = np.diff(rows) / frame_rate_hz
    moved_m = np.linalg.norm(np.diff(path.xyz_m[rows], axis=0), axis=-1)
    borders = np.flatnonzero((passed_s > _LONGEST_GAP_S) | (moved_m > _JUMP_M + _FASTEST_M_S * passed_s))
    firsts, lasts = np.append(0, borders + 1), np.append(borders, len(rows) - 1)
    yield from zip(rows[firsts].tolist(), rows[lasts].tolist(), strict=True)


@dataclass(frozen=True, slots=True, order=True)
class DoubtfulMoment:
    """Moment at which a track may have changed to another person."""

    frame: int  # First output frame after it
    tracks: tuple[int, ...]  # Two tracks that may have been exchanged, or the one track that may have changed


def encounters(paths: Sequence[Path], frame_rate_hz: float) -> list[DoubtfulMoment]:
    """Find the moments at which two tracks came so near that they may have been exchanged."""
    longest_gap = round(_LONGEST_GAP_S * frame_rate_hz)
    moments = []
    for first, second in pairs_within(paths, _REACH_M):
        start = max(paths[first].start_frame, paths[second].start_frame)
        stop = min(paths[first].stop_frame, paths[second].stop_frame)
        rows = [slice(start - path.start_frame, stop - path.start_frame) for path in (paths[first], paths[second])]
        apart_m = np.linalg.norm(paths[first].xyz_m[rows[0]] - paths[second].xyz_m[rows[1]], axis=-1)
        moments += [DoubtfulMoment(start + nearest, (first, second)) for nearest in _nearest(apart_m, longest_gap)]
    return moments


def pairs_within(paths: Sequence[Path], reach_m: float) -> Iterator[tuple[int, int]]:
    """Pairs of paths that overlap in time and whose bounding boxes are within reach of each other."""
    if not paths:
        return
    low_m = np.array([np.fmin.reduce(path.xyz_m) for path in paths])
    high_m = np.array([np.fmax.reduce(path.xyz_m) for path in paths])
    start, stop = (np.array([getattr(path, name) for path in paths]) for name in ("start_frame", "stop_frame"))
    for first in range(len(paths)):
        later = slice(first + 1, None)
        near = (low_m[later] <= high_m[first] + reach_m).all(-1) & (high_m[later] >= low_m[first] - reach_m).all(-1)
        near &= (start[later] < stop[first]) & (stop[later] > start[first])
        yield from ((first, first + 1 + int(other)) for other in np.flatnonzero(near))


def _nearest(apart_m: Float[np.ndarray, " frames"], longest_gap: int) -> Iterator[int]:
    """Row of the least distance of each time for which two people are within reach."""
    near = np.flatnonzero(apart_m < _REACH_M)
    for rows in np.split(near, np.flatnonzero(np.diff(near) > max(1, longest_gap)) + 1):
        if len(rows):
            yield int(rows[np.argmin(apart_m[rows])])


def cut_at_moments(pieces: Sequence[Tracklet], moments: Sequence[DoubtfulMoment]) -> list[Tracklet]:
    """Cut tracklets at moments of doubt, in order of time; sorted by first frame."""
    by_track: dict[int, list[int]] = {}
    for number, moment in enumerate(moments):
        for track in moment.tracks:
            by_track.setdefault(track, []).append(number)
    cut = []
    for piece in pieces:
        start, before = piece.start_frame, -1
        for number in by_track.get(piece.track, ()):
            frame = moments[number].frame
            if start < frame < piece.stop_frame:
                cut.append(Tracklet(piece.track, start, frame, before, number))
                start, before = frame, number
        cut.append(Tracklet(piece.track, start, piece.stop_frame, before, -1))
    return sorted(cut, key=lambda tracklet: (tracklet.start_frame, tracklet.track))


# Stretch of a path from which its velocity at an end is measured, and longest time for which it is extrapolated.
_VELOCITY_S, _EXTRAPOLATED_S = 0.4, 0.3
# Standard deviation of a body's position after a gap: at once, for each second, and at most.
_NOISE_M, _WANDER_M_S, _FARTHEST_M = 0.15, 1.2, 3.0
# Standard deviation along each axis of the change of a person's velocity at once and for each second, and of the
# difference of the velocities of unrelated people.
_CHANGE_M_S, _ACCELERATION_M_S2, _UNRELATED_M_S = 0.6, 2.0, 1.2
# Longest absence of a person who is known again. Tracks hold every frame in between.
_LONGEST_ABSENCE_S = 600.0
# No person is faster on average, beside the noise of both ends.
_FASTEST_LINK_M_S, _FASTEST_NOISE_M = 6.0, 0.6
# Time after which the place says little of the person, and share of bodies that are anywhere even at once.
_FORGOTTEN_S, _ANYWHERE = 2.0, 1e-3
_SMALLEST_AREA_M2 = 10.0
# Log-odds, before any measurement, that a track that continues at a moment of doubt is of one person (two tracks at an
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

    ``last``, ``first``: ends of the earlier and beginnings of the later tracklets; their arrays are broadcast against
    each other. Returns ratio of each pair; minus infinity where the later tracklet does not come later, or is too far
    away for any speed.
    """
    gap_s = first.time_s - last.time_s
    ahead_s = np.clip(gap_s / 2, 0.0, _EXTRAPOLATED_S)[..., None]
    between_m = (first.xyz_m - ahead_s * first.velocity_m_s) - (last.xyz_m + ahead_s * last.velocity_m_s)
    squared_m2 = (between_m[..., :2] ** 2).sum(-1)
    apart_m = np.linalg.norm(first.xyz_m - last.xyz_m, axis=-1)
    possible: Bool[np.ndarray, "*batch"] = (
        (gap_s > 0) & (gap_s <= _LONGEST_ABSENCE_S) & (apart_m <= _FASTEST_NOISE_M + _FASTEST_LINK_M_S * gap_s)
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
