"""Edits of people: who is who, put right by hand. Standard library only: the web API imports this module.

Edits are data. Each edit is applied to the people that the earlier edits leave. Without edits a take is as the
reconstruction found it. Frames are numbered as in the reconstruction, also after a cut.
"""

import unicodedata
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from heapq import merge
from operator import attrgetter
from typing import Any, ClassVar, Literal, NoReturn

from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.request_codes import EDIT_IMPOSSIBLE, EDITS_FRAGMENTED

MAX_EDITS = 1000
"""Largest number of edits of a take."""
MAX_NAME_LENGTH = 100
"""Largest number of characters of a person's name."""
MAX_PIECES = 2000
"""Largest number of pieces of which all people of a take may consist after new edits."""

# Characters of a name before it is normalized: a character may come in some parts.
_MAX_SENT_NAME_LENGTH = 5 * MAX_NAME_LENGTH
_START, _STOP = attrgetter("start_frame"), attrgetter("stop_frame")


@dataclass(frozen=True, slots=True)
class PersonSpan:
    """A person of a take, with the frames from the first to the last one."""

    id: int
    start_frame: int
    num_frames: int


def _require_action(schema: dict[str, Any]) -> None:
    schema["required"] = ["action", *schema["required"]]


class _Edit:
    """Base of the edits."""

    __slots__ = ()
    # The web API's parser refuses unknown fields, and finds the kind of an edit by its action.
    __pydantic_config__: ClassVar[Mapping[str, Any]] = {"extra": "forbid", "json_schema_extra": _require_action}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rename(_Edit):
    """Give a person a name."""

    action: Literal["rename"] = "rename"
    person: int
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove(_Edit):
    """Remove a person from the take."""

    action: Literal["remove"] = "remove"
    person: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Merge(_Edit):
    """Make one person of two. ``person`` stays; in frames of both, ``person`` counts and ``other`` is left out."""

    action: Literal["merge"] = "merge"
    person: int
    other: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Split(_Edit):
    """Make two people of one. From ``frame`` on it is a new person, with the next free number."""

    action: Literal["split"] = "split"
    person: int
    frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange(_Edit):
    """Exchange two people from ``start_frame`` on, up to ``stop_frame`` or else to the end."""

    action: Literal["exchange"] = "exchange"
    person: int
    other: int
    start_frame: int
    stop_frame: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Cut(_Edit):
    """Keep the frames from ``start_frame`` to the one before ``stop_frame`` alone."""

    action: Literal["cut"] = "cut"
    start_frame: int
    stop_frame: int


PeopleEdit = Rename | Remove | Merge | Split | Exchange | Cut
"""An edit of people."""

_BY_ACTION: Mapping[str, type[PeopleEdit]] = {
    "rename": Rename,
    "remove": Remove,
    "merge": Merge,
    "split": Split,
    "exchange": Exchange,
    "cut": Cut,
}


@dataclass(frozen=True, slots=True)
class Piece:
    """Frames of a person of the reconstruction."""

    person: int
    start_frame: int
    stop_frame: int


@dataclass(frozen=True, slots=True)
class EditedPerson:
    """A person after all edits."""

    id: int  # Number of the person
    pieces: tuple[Piece, ...]  # Frames of people of the reconstruction, ascending, without overlaps, at least one
    name: str | None = None  # Name that was given; ``None``: none was

    @property
    def start_frame(self) -> int:
        """First frame."""
        return self.pieces[0].start_frame

    @property
    def stop_frame(self) -> int:
        """Frame after the last one."""
        return self.pieces[-1].stop_frame


@dataclass(frozen=True, slots=True)
class EditedTake:
    """People after all edits, in the order of their numbers, and the frames that a cut keeps; ``None``: all."""

    people: tuple[EditedPerson, ...]
    frames: range | None = None


def without_names(edits: Sequence[PeopleEdit]) -> tuple[PeopleEdit, ...]:
    """Edits that say who is where; people's names are left out."""
    return tuple(edit for edit in edits if not isinstance(edit, Rename))


def read_edit(document: Mapping[str, Any]) -> PeopleEdit:
    """Edit from its JSON object, as ``edit_document`` makes it."""
    return _BY_ACTION[document["action"]](**document)


def edit_document(edit: PeopleEdit) -> dict[str, Any]:
    """JSON object of an edit."""
    return asdict(edit)


def apply_edits(
    people: Sequence[PersonSpan], edits: Sequence[PeopleEdit], num_frames: int, max_pieces: int | None = None
) -> EditedTake:
    """Find out what is whose after all edits.

    Parameters
    ----------
    edits
        In the order in which they were made.
    max_pieces
        Largest number of pieces of which all people may consist; ``None``: any number, for edits that are stored.

    Raises
    ------
    InputError
        With the problems of the first edit that can't be made; the field is ``edits/NUMBER/NAME``, numbers from 0.
    """
    take = _Take(
        {
            person.id: EditedPerson(
                person.id, (Piece(person.id, person.start_frame, person.start_frame + person.num_frames),)
            )
            for person in people
        },
        num_frames,
    )
    for number, edit in enumerate(edits):
        take.at = f"edits/{number}"
        take.apply(edit)
        if max_pieces is not None:
            take.require_pieces(max_pieces)
    return EditedTake(tuple(take.people[number] for number in sorted(take.people)), take.frames)


@dataclass(slots=True)
class _Take:
    """State of a take between two edits."""

    people: dict[int, EditedPerson]
    num_frames: int
    frames: range | None = None
    at: str = "edits"
    _last_id: int = field(init=False)

    def __post_init__(self) -> None:
        self._last_id = max(self.people, default=0)

    def apply(self, edit: PeopleEdit) -> None:
        """Make an edit; ``InputError`` if it can't be made."""
        match edit:
            case Rename(person=person, name=name):
                self.people[person] = replace(self._person(person), name=self._name(name))
            case Remove(person=person):
                del self.people[self._person(person).id]
            case Merge(person=person, other=other):
                kept, added = self._two(person, other)
                del self.people[added.id]
                self.people[kept.id] = replace(
                    kept, pieces=_joined(_united(kept.pieces, added.pieces)), name=kept.name or added.name
                )
            case Split(person=person, frame=frame):
                self._split(self._person(person), frame)
            case Exchange(person=person, other=other, start_frame=start, stop_frame=stop):
                self._exchange(*self._two(person, other), start, self.num_frames if stop is None else stop)
            case Cut(start_frame=start, stop_frame=stop):
                self.frames = self._range(start, stop)

    def require_pieces(self, max_pieces: int) -> None:
        """Raise ``InputError`` if the people consist of more pieces."""
        if (num_pieces := sum(len(person.pieces) for person in self.people.values())) > max_pieces:
            message = f"After this edit the people would consist of {num_pieces:,} pieces; {max_pieces:,} are allowed."
            hint = "Leave this edit and those after it out, or exchange people in fewer places."
            raise InputError([Problem(EDITS_FRAGMENTED, message, field=self.at, hint=hint)])

    def _person(self, number: int, name: str = "person") -> EditedPerson:
        if number not in self.people:
            there = ", ".join(map(str, sorted(self.people))) or "none"
            self._refuse(name, f"There is no person {number} at this point.", f"The people are: {there}.")
        return self.people[number]

    def _two(self, person: int, other: int) -> tuple[EditedPerson, EditedPerson]:
        if person == other:
            self._refuse("other", f"Person {person} is named twice.", "Name two people.")
        return self._person(person), self._person(other, "other")

    def _name(self, name: str) -> str:
        # To normalize long runs of combining characters takes quadratic time.
        is_short = len(name) <= _MAX_SENT_NAME_LENGTH
        stripped = unicodedata.normalize("NFC", name).strip() if is_short else name
        if not 0 < len(stripped) <= MAX_NAME_LENGTH:
            self._refuse("name", f"A name has 1 to {MAX_NAME_LENGTH} characters.", "Choose another name.")
        if any(unicodedata.category(character).startswith("C") for character in stripped):
            self._refuse("name", "Control characters are not allowed in a name.", "Choose another name.")
        return stripped

    def _split(self, person: EditedPerson, frame: int) -> None:
        if not person.start_frame < frame < person.stop_frame:
            first, last = person.start_frame + 1, person.stop_frame - 1
            hint = f"Choose a frame from {first} to {last}." if first <= last else "It has a single frame."
            self._refuse("frame", f"Person {person.id} can't be split at frame {frame}.", hint)
        self._last_id += 1
        self.people[person.id] = replace(person, pieces=_within(person.pieces, person.start_frame, frame))
        self.people[self._last_id] = EditedPerson(self._last_id, _within(person.pieces, frame, person.stop_frame))

    def _exchange(self, first: EditedPerson, second: EditedPerson, start: int, stop: int) -> None:
        self._range(start, stop)
        exchanged = {
            mine.id: _chained(
                _within(mine.pieces, 0, start),
                _within(theirs.pieces, start, stop),
                _within(mine.pieces, stop, self.num_frames),
            )
            for mine, theirs in ((first, second), (second, first))
        }
        if exchanged[first.id] == first.pieces:
            self._refuse("start_frame", "Neither person is there in these frames.", "Choose other frames.")
        for person in (first, second):
            if exchanged[person.id]:
                self.people[person.id] = replace(person, pieces=exchanged[person.id])
            else:
                del self.people[person.id]

    def _range(self, start: int, stop: int) -> range:
        if not 0 <= start < stop <= self.num_frames:
            message = f"The frames {start} to {stop} are not a part of the take."
            self._refuse(
                "stop_frame", message, f"The take has the frames 0 to {self.num_frames}; the last is excluded."
            )
        return range(start, stop)

    def _refuse(self, name: str, message: str, hint: str) -> NoReturn:
        raise InputError([Problem(EDIT_IMPOSSIBLE, message, field=f"{self.at}/{name}", hint=hint)])


def _within(pieces: Sequence[Piece], start: int, stop: int) -> tuple[Piece, ...]:
    """Parts of pieces within frames."""
    first, end = bisect_right(pieces, start, key=_STOP), bisect_left(pieces, stop, key=_START)
    inside = list(pieces[first:end])
    if inside:
        inside[0] = replace(inside[0], start_frame=max(inside[0].start_frame, start))
        inside[-1] = replace(inside[-1], stop_frame=min(inside[-1].stop_frame, stop))
    return tuple(inside)


def _chained(*parts: Sequence[Piece]) -> tuple[Piece, ...]:
    """Pieces of parts that follow each other, joined where a part continues the last piece."""
    chain: list[Piece] = []
    for part in parts:
        if part:
            chain[-1:] = _joined((*chain[-1:], part[0]))
            chain += part[1:]
    return tuple(chain)


def _joined(pieces: Iterable[Piece]) -> tuple[Piece, ...]:
    """Ascending pieces, those joined that continue each other."""
    joined: list[Piece] = []
    for piece in pieces:
        last = joined[-1] if joined else None
        if last is not None and last.person == piece.person and last.stop_frame == piece.start_frame:
            joined[-1] = replace(last, stop_frame=piece.stop_frame)
        else:
            joined.append(piece)
    return tuple(joined)


def _united(first: Sequence[Piece], second: Sequence[Piece]) -> Iterator[Piece]:
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
