"""Pieces of edited people: frames of the people of a run, cut out, put together and united."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from operator import attrgetter

_START, _STOP = attrgetter("start_frame"), attrgetter("stop_frame")


@dataclass(frozen=True, slots=True)
class Piece:
    """Frames of a person of the run before any edit, numbered from the run's first frame."""

    person: int
    start_frame: int
    stop_frame: int


def piece_at(pieces: Sequence[Piece], frame: int) -> Piece | None:
    """Piece that has a frame; ``None`` if none has."""
    number = bisect_right(pieces, frame, key=_START) - 1
    return pieces[number] if number >= 0 and frame < pieces[number].stop_frame else None


def within(pieces: Sequence[Piece], start: int, stop: int) -> tuple[Piece, ...]:
    """Parts of pieces within frames."""
    first, end = bisect_right(pieces, start, key=_STOP), bisect_left(pieces, stop, key=_START)
    inside = list(pieces[first:end])
    if inside:
        inside[0] = replace(inside[0], start_frame=max(inside[0].start_frame, start))
        inside[-1] = replace(inside[-1], stop_frame=min(inside[-1].stop_frame, stop))
    return tuple(inside)


def chained(*parts: Sequence[Piece]) -> tuple[Piece, ...]:
    """Pieces of parts that follow each other, joined where a part continues the last piece."""
    chain: list[Piece] = []
    for part in parts:
        if part:
            chain[-1:] = joined((*chain[-1:], part[0]))
            chain += part[1:]
    return tuple(chain)


def joined(pieces: Iterable[Piece]) -> tuple[Piece, ...]:
    """Ascending pieces, those joined that continue each other."""
    joined: list[Piece] = []
    for piece in pieces:
        last = joined[-1] if joined else None
        if last is not None and last.person == piece.person and last.stop_frame == piece.start_frame:
            joined[-1] = replace(last, stop_frame=piece.stop_frame)
        else:
            joined.append(piece)
    return tuple(joined)


def united(first: Sequence[Piece], second: Sequence[Piece]) -> Iterator[Piece]:
    """Pieces of both, ascending; where they overlap, pieces of the first."""
    return merge(first, _outside(first, second), key=_START)


def _outside(covering: Sequence[Piece], pieces: Sequence[Piece]) -> Iterator[Piece]:
    """Parts of ascending pieces in frames that no covering piece has; each sequence is read once."""
    number = 0
    for piece in pieces:
        start = piece.start_frame
        while number < len(covering) and covering[number].start_frame < piece.stop_frame:
            cover = covering[number]
            if start < cover.start_frame:
                yield replace(piece, start_frame=start, stop_frame=cover.start_frame)
            start = max(start, cover.stop_frame)
            if cover.stop_frame > piece.stop_frame:
                break  # it covers frames of the next piece too
            number += 1
        if start < piece.stop_frame:
            yield replace(piece, start_frame=start)
