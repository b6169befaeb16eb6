"""People in files: tracks and observations are read one by one, because all of a long session's are large."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar, overload

import numpy as np
from jaxtyping import Float

from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.people import Doubt, Leftovers, Observations, People, PersonLoss, Track3D
from pipeline.core.joints import JointSet
from pipeline.core.options.edits import PersonSpan
from pipeline.core.runtime.record_archive import RecordArchive, save
from pipeline.run.engine.stage import Context

_Record = TypeVar("_Record")

# Largest distance between a body's centre and the line between two places of its span.
_TOLERANCE_M = 0.05
# Largest numbers of places of a person and of all people.
_MAX_PLACES, _MAX_PLACES_OF_ALL = 400, 20_000


class _Summary(NamedTuple):
    """All of stored people but their tracks and observations."""

    spans: tuple[PersonSpan, ...]
    num_approximate_frames: int
    doubts: Sequence[Sequence[Doubt]]
    leftovers: Leftovers | None
    damaged: tuple[DamagedVideo, ...]
    losses: Sequence[PersonLoss] = ()


class _Stored(NamedTuple):
    summary: _Summary
    tracks: Sequence[Track3D]
    observations: Sequence[Observations]


def write_people(
    path: Path, people: People, damaged: Sequence[DamagedVideo] = (), joints: JointSet | None = None
) -> None:
    """Write tracks with the observations behind them, and the damaged videos among those that they come from.

    With ``joints``, the names of the tracks' joints, the people's spans have places, by which edits find them.
    """
    tracks = tuple(people.tracks)
    max_places = min(_MAX_PLACES, max(2, _MAX_PLACES_OF_ALL // max(1, len(tracks))))
    spans = tuple(
        PersonSpan(
            track.track_id,
            track.start_frame,
            track.num_frames,
            () if joints is None else _places(track, joints, max_places),
        )
        for track in tracks
    )
    figures = people.num_approximate_frames, people.doubts, people.leftovers, tuple(damaged), people.losses
    summary = _Summary(spans, *figures)
    save(_Stored(summary, tracks, people.observations), path)


def _places(track: Track3D, joints: JointSet, max_places: int) -> tuple[tuple[int, float, float, float], ...]:
    """Places of a body: middle of the hips, or of all known joints where a hip is missing.

    Of all frames those are kept between which the body moves along a line (Douglas and Peucker 1973, with the distance
    at the same time); a tolerance of 5 cm is doubled until they are few enough.
    """
    centre_m = np.full((track.num_frames, 3), np.nan)
    known = np.isfinite(track.xyz_m).all(-1)
    for row in np.flatnonzero(known.any(-1)):
        centre_m[row] = track.xyz_m[row, known[row]].mean(0)
    hips = [number for number, name in enumerate(joints.names) if name in ("left_hip", "right_hip")]
    has_hips = known[:, hips].all(-1) if hips else np.zeros(track.num_frames, bool)
    centre_m[has_hips] = track.xyz_m[:, hips][has_hips].mean(1)
    rows = np.flatnonzero(np.isfinite(centre_m).all(-1))
    tolerance_m = _TOLERANCE_M
    while len(kept := _corners(rows, centre_m[rows], tolerance_m)) > max_places:
        tolerance_m *= 2
    places_m = ([round(float(axis), 3) for axis in centre_m[row]] for row in rows[kept])
    return tuple((track.start_frame + int(row), x, y, z) for row, (x, y, z) in zip(rows[kept], places_m, strict=True))


def _corners(time: np.ndarray, points: Float[np.ndarray, "n 3"], tolerance: float) -> list[int]:
    """Numbers of the points, ascending, between which lines pass all points within a tolerance."""
    kept, parts = {0, len(points) - 1} if len(points) else set(), [(0, len(points) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        share = (time[first : last + 1] - time[first]) / (time[last] - time[first])
        line = points[first] + share[:, None] * (points[last] - points[first])
        distance = np.linalg.norm(points[first : last + 1] - line, axis=1)
        farthest = int(distance.argmax())
        if distance[farthest] > tolerance:
            kept.add(first + farthest)
            parts += [(first, first + farthest), (first + farthest, last)]
    return sorted(kept)


class StoredPeople:
    """People that ``write_people`` wrote. Their file at ``path`` stays."""

    def __init__(self, path: Path) -> None:
        self._archive = RecordArchive(path)
        self._summary = self._archive.read(_Summary, "summary")

    @property
    def spans(self) -> tuple[PersonSpan, ...]:
        """Frames of each person, in their order."""
        return self._summary.spans

    @property
    def damaged(self) -> tuple[DamagedVideo, ...]:
        """Damaged videos among those that the people come from."""
        return self._summary.damaged

    @property
    def people(self) -> People:
        """People whose tracks and observations are read whenever they are asked for."""
        number = len(self.spans)
        tracks = StoredSequence(number, lambda k: self._archive.read(Track3D, "tracks", k))
        observations = StoredSequence(number, lambda k: self._archive.read(Observations, "observations", k))
        summary = self._summary
        return People(
            tracks, observations, summary.num_approximate_frames, summary.doubts, summary.leftovers, summary.losses
        )


def found_people(context: Context, stage: str) -> StoredPeople:
    """People that a stage found, in a file: in memory they would be a fifth of what a stage takes."""
    path = context.scratch / f"of-{stage}.npz"
    context.copy_output(stage, 0, path)
    return StoredPeople(path)


class StoredSequence(Sequence[_Record]):
    """Records, each read or made at each access."""

    def __init__(self, num_records: int, read: Callable[[int], _Record]) -> None:
        self._numbers, self._read = range(num_records), read

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, index: int) -> _Record: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[_Record]: ...

    def __getitem__(self, index: int | slice) -> _Record | Sequence[_Record]:
        numbers = self._numbers[index]
        return self._read(numbers) if isinstance(numbers, int) else [self._read(number) for number in numbers]
