"""People in files: tracks and observations are read one by one, because all of a long session's are large."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar, overload

from pipeline.core.data.detections import DamagedVideo
from pipeline.core.data.people import Doubt, Leftovers, Observations, People, PersonLoss, Track3D
from pipeline.core.options.edits import PersonSpan
from pipeline.run.engine.codec import RecordArchive, save
from pipeline.run.engine.stage import Context

_Record = TypeVar("_Record")


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


def write_people(path: Path, people: People, damaged: Sequence[DamagedVideo] = ()) -> None:
    """Write tracks with the observations behind them, and the damaged videos among those that they come from."""
    tracks = tuple(people.tracks)
    spans = tuple(PersonSpan(track.track_id, track.start_frame, track.num_frames) for track in tracks)
    figures = people.num_approximate_frames, people.doubts, people.leftovers, tuple(damaged), people.losses
    summary = _Summary(spans, *figures)
    save(_Stored(summary, tracks, people.observations), path)


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
    path.write_bytes(*context.outputs(stage))
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
