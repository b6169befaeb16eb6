"""Pieces of tracks over which identity is not in doubt, and the moments between them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.core.data.people import Track3D
from pipeline.core.joints import JointSet

_TORSO = "left_shoulder", "right_shoulder", "left_hip", "right_hip"
# A person who was located in no frame for longer may be somebody else afterwards.
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


def path_of(track: Track3D, joints: JointSet) -> Path:
    """Way of a track's trunk; see ``Path``."""
    torso = [joints.index(name) for name in _TORSO if name in joints.names]
    return Path(track.start_frame, _first_known(_mean(track.xyz_m[:, torso]), _mean(track.xyz_m)))


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
    """Cut tracks where nobody was located for a while, and where the body jumped."""
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


def _mean(xyz_m: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames 3"]:
    """Mean over the known joints, NaN without any."""
    known = np.isfinite(xyz_m[..., 0])
    count = known.sum(-1)
    total = np.where(known[..., None], xyz_m, 0.0).sum(1)
    with np.errstate(invalid="ignore"):
        return np.asarray(total / np.where(count, count, np.nan)[:, None])


def _first_known(
    first: Float[np.ndarray, "frames 3"], second: Float[np.ndarray, "frames 3"]
) -> Float[np.ndarray, "frames 3"]:
    known: Bool[np.ndarray, "frames 3"] = np.isfinite(first)
    return np.where(known, first, second)
