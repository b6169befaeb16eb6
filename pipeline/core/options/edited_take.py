"""Edits applied to the people of a run: who is who after them, and which of them can't be applied. Standard library."""

import math
import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from types import MappingProxyType
from typing import Any, NoReturn

from pipeline.core.errors import InputError, Problem
from pipeline.core.options.edit_pieces import Piece, chained, joined, piece_at, united, within
from pipeline.core.options.edits import (
    CAMERA_KINDS,
    LEAST_MASS_KG,
    MAX_DISTANCE_M,
    MAX_KEY_M,
    MAX_NAME_LENGTH,
    MAX_PIECES,
    MOST_MASS_KG,
    Accept,
    Correction,
    Cut,
    Describe,
    Exchange,
    KeyJoint,
    Merge,
    Named,
    PeopleEdit,
    PersonAt,
    PersonSpan,
    PlaceDetection,
    Remove,
    Rename,
    Split,
    frames_of,
)
from pipeline.core.problems.request_codes import EDIT_IMPOSSIBLE, EDITS_FRAGMENTED

Known = Mapping[str, Collection[str]]
"""Names that a correction may have, by its field: ``camera``, ``joint``, ``part``."""

_FRAMES = ("frame", "start_frame", "stop_frame")
# Characters of a name before it is normalized: a character may come in some parts.
_MAX_SENT_NAME_LENGTH = 5 * MAX_NAME_LENGTH
# Names of people without a name.
_DEFAULT_NAME = re.compile(r"person-\d+", re.IGNORECASE)
# Frames of a person among which one is chosen for a place, and the distance to others beyond which all are alike.
_NUM_CANDIDATES, _APART_M = 8, 1.0


@dataclass(frozen=True, slots=True)
class EditedPerson:
    """A person after all edits."""

    # Number. People of the run keep theirs; new people have the numbers after them, by their first frames.
    id: int
    pieces: tuple[Piece, ...]  # Frames of people of the run, ascending, without overlaps, at least one
    name: str | None = None  # Name that was given; ``None``: none was
    described: Describe | None = None  # Sex and mass that were stated; its ``person`` is 0
    # Corrections of the person, and places that are right; frames are numbered from the run's first frame
    corrections: tuple[Correction, ...] = ()
    accepted: tuple[Accept, ...] = ()

    @property
    def start_frame(self) -> int:
        """First frame."""
        return self.pieces[0].start_frame

    @property
    def stop_frame(self) -> int:
        """Frame after the last one."""
        return self.pieces[-1].stop_frame


@dataclass(frozen=True, slots=True)
class EditOutcome:
    """Outcome of an edit in a run.

    ``person`` and ``other`` are the numbers, after all edits, of the people whom it names; ``None``: no such person, or
    a new person who is gone. ``problem`` says why the edit is not applied; ``None``: it is.
    """

    person: int | None = None
    other: int | None = None
    problem: Problem | None = None


@dataclass(frozen=True, slots=True)
class EditedTake:
    """People after all edits, in the order of their numbers.

    ``frames`` are the frames that a cut keeps, numbered from the run's first frame; ``None``: all. ``outcomes`` has one
    for each edit. ``accepted`` are cameras that are right.
    """

    people: tuple[EditedPerson, ...]
    frames: range | None = None
    outcomes: tuple[EditOutcome, ...] = ()
    accepted: tuple[Accept, ...] = ()


def apply_edits(
    people: Sequence[PersonSpan], edits: Sequence[PeopleEdit], frames: range, known: Known = MappingProxyType({})
) -> EditedTake:
    """Find out what is whose after all edits.

    ``people``: people of a run, before any edit. ``edits``: in the order in which they were made. ``frames``: frames of
    the run, in the session's numbering. ``known``: cameras and joints of the run; fields that are missing are not
    checked.
    """
    take = _Take.of(people, frames)
    take.known = known
    for number, edit in enumerate(edits):
        take.number = number
        try:
            take.apply(edit)
        except InputError as error:
            take.problems[number] = error.problems[0]
    return take.edited(len(edits))


def place_edits(people: Sequence[PersonSpan], edits: Sequence[PeopleEdit], frames: range) -> tuple[PeopleEdit, ...]:
    """Replace numbers of people by places, so that other runs find the people too, and normalize names.

    Parameters as in ``apply_edits``.

    Raises ``InputError``: with the problems of the first edit that is malformed, or that names people by numbers and
    can't be applied; the field is ``edits/NUMBER/NAME``, numbers from 0.
    """
    take = _Take.of(people, frames)
    placed: list[PeopleEdit] = []
    for number, edit in enumerate(edits):
        take.number = number
        well_formed = take.well_formed(edit)
        placed.append(take.placed(well_formed))
        try:
            take.apply(edit)
        except InputError:
            if placed[-1] is not well_formed:
                raise
    return tuple(placed)


def require_places(edits: Sequence[PeopleEdit]) -> None:
    """Raise ``InputError`` for the first edit that names a person by a number, because no run is at hand."""
    for number, edit in enumerate(edits):
        for name in ("person", "other"):
            if isinstance(getattr(edit, name, None), int):
                message, hint = "The edit names a person by number.", "Name its run too, or the person by a place."
                raise InputError([Problem(EDIT_IMPOSSIBLE, message, field=f"edits/{number}/{name}", hint=hint)])


@dataclass(slots=True)
class _Take:
    """State of a take between two edits. Keys of people of the run are their numbers; new people have the next ones."""

    found: Mapping[int, PersonSpan]
    people: dict[int, EditedPerson]  # By key
    frames: range  # Of the run, in the session's numbering
    kept: range | None = None
    number: int = 0  # Of the edit at hand, from 0
    named: dict[tuple[int, str], int] = field(default_factory=dict)  # Keys of people by number and field of the edit
    problems: dict[int, Problem] = field(default_factory=dict)  # By the number of the edit
    last_key: int = 0
    known: Known = field(default_factory=dict)
    # Number of a person of the run and frame by which a body is named, with its correction, in the order of the edits
    corrections: list[tuple[int, int, Correction | Accept]] = field(default_factory=list)
    accepted: list[Any] = field(default_factory=list)  # Accepted places of cameras

    @classmethod
    def of(cls, people: Sequence[PersonSpan], frames: range) -> "_Take":
        """State before any edit."""
        whole = {
            person.id: EditedPerson(
                person.id, (Piece(person.id, person.start_frame, person.start_frame + person.num_frames),)
            )
            for person in people
        }
        return cls({person.id: person for person in people}, whole, frames, last_key=max(whole, default=0))

    def edited(self, num_edits: int) -> EditedTake:
        """People with their numbers, and the outcomes of the edits."""
        numbers = self._numbers()

        def number_of(edit: int, name: str) -> int | None:
            key = self.named.get((edit, name))
            return numbers.get(key, key if key in self.found else None) if key is not None else None

        corrections = self._by_person(numbers)
        people = (
            replace(
                person,
                id=numbers[key],
                corrections=tuple(edit for edit in corrections[key] if not isinstance(edit, Accept)),
                accepted=tuple(edit for edit in corrections[key] if isinstance(edit, Accept)),
            )
            for key, person in self.people.items()
        )
        return EditedTake(
            tuple(sorted(people, key=attrgetter("id"))),
            self.kept,
            tuple(
                EditOutcome(number_of(edit, "person"), number_of(edit, "other"), self.problems.get(edit))
                for edit in range(num_edits)
            ),
            tuple(self.accepted),
        )

    def placed(self, edit: PeopleEdit) -> PeopleEdit:
        """Edit that names people by places; the same one if it does already."""
        near: dict[str, int] = {}
        if isinstance(edit, Split | Exchange | Correction | Accept):
            frame = (edit.start_frame if hasattr(edit, "start_frame") else edit.frame) - self.frames.start
            # Exchanged is who was one before with who is the other one from then on: other runs may have it right.
            near = {"person": frame - isinstance(edit, Exchange), "other": frame}
        numbered: dict[str, Any] = {
            name: self._place(self._person(named, name), near.get(name))
            for name in ("person", "other")
            if isinstance(named := getattr(edit, name, None), int)
        }
        return replace(edit, **numbered) if numbered else edit

    def well_formed(self, edit: PeopleEdit) -> PeopleEdit:
        """Edit with a normalized name; ``InputError`` if no run could apply it."""
        start, stop = getattr(edit, "start_frame", getattr(edit, "frame", 0)), getattr(edit, "stop_frame", None)
        if start < 0 or (stop is not None and stop <= start):
            message = f"The frames {start} to {stop} are no frames."
            self._refuse("stop_frame", message, "The first frame is 0, and stop_frame is excluded.")
        if isinstance(edit, Accept):
            of_camera = edit.kind in CAMERA_KINDS
            if (edit.camera is not None, edit.person is not None) != (of_camera, not of_camera):
                named, other = ("camera", "person") if of_camera else ("person", "camera")
                self._refuse(named, f"{edit.kind} is about a {named}.", f"Name a {named}, and no {other}.")
        if isinstance(edit, Describe) and not LEAST_MASS_KG <= (edit.mass_kg or LEAST_MASS_KG) <= MOST_MASS_KG:
            message = f"A mass is {LEAST_MASS_KG:g} to {MOST_MASS_KG:g} kg."
            self._refuse("mass_kg", message, "State it in kilograms, or null.")
        return replace(edit, name=self._normalized(edit.name)) if isinstance(edit, Rename) else edit

    def apply(self, edit: PeopleEdit) -> None:
        """Make an edit; ``InputError`` if it can't be made."""
        match self.well_formed(edit):
            case Rename(person=person, name=name):
                renamed = self._person(person)
                self._require_free(renamed, name)
                self.people[renamed.id] = replace(renamed, name=name)
            case Describe(person=person) as description:
                described = self._person(person)
                self.people[described.id] = replace(described, described=replace(description, person=0))
            case Remove(person=person):
                del self.people[self._person(person).id]
            case Merge(person=person, other=other):
                self._merge(*self._two(person, other))
            case Split(person=person, frame=frame):
                self._split(self._person(person), frame, isinstance(person, PersonAt))
            case Exchange(person=person, other=other, start_frame=start, stop_frame=stop):
                first, second = self._two(person, other)
                self._exchange(first, second, self._range(start, self.frames.stop if stop is None else stop))
            case Cut(start_frame=start, stop_frame=stop):
                self.kept = self._range(start, stop)
            case correction:
                self._correct(correction)

    def _by_person(self, numbers: Mapping[int, int]) -> Mapping[int, Sequence[Correction | Accept]]:
        """Corrections by the key of the person who has the body in the end, with this person's number."""
        holders: dict[int, set[int]] = {}
        for key, person in self.people.items():
            for piece in person.pieces:
                holders.setdefault(piece.person, set()).add(key)
        corrections: dict[int, list[Correction | Accept]] = {key: [] for key in self.people}
        for number, frame, edit in self.corrections:
            for key in holders.get(number, ()):
                piece_there = piece_at(self.people[key].pieces, frame)
                if piece_there is not None and piece_there.person == number:
                    corrections[key].append(replace(edit, person=numbers[key]))
        return corrections

    def _numbers(self) -> dict[int, int]:
        new = [person for key, person in self.people.items() if key not in self.found]
        new.sort(key=lambda person: (person.start_frame, person.pieces[0].person))
        numbers = {key: key for key in self.people if key in self.found}
        return numbers | {person.id: number for number, person in enumerate(new, max(self.found, default=0) + 1)}

    def _person(self, named: Named, name: str = "person") -> EditedPerson:
        person = self._person_at(named, name) if isinstance(named, PersonAt) else self._numbered(named, name)
        self.named[self.number, name] = person.id
        return person

    def _numbered(self, number: int, name: str) -> EditedPerson:
        for key, its_number in self._numbers().items():
            if its_number == number:
                return self.people[key]
        there = ", ".join(map(str, sorted(self._numbers().values()))) or "none"
        self._refuse(name, f"There is no person {number} at this point.", f"The people are: {there}.")

    def _person_at(self, at: PersonAt, name: str) -> EditedPerson:
        """Person who has the frame of the run's person nearest to a place."""
        frame = at.frame - self.frames.start
        there = [
            (math.dist(person.place_m(frame), at.place_m), number)
            for number, person in self.found.items()
            if person.start_frame <= frame < person.start_frame + person.num_frames
        ]
        distance_m, number = min(there, default=(math.inf, 0))
        if not distance_m <= MAX_DISTANCE_M:
            place = ", ".join(f"{axis:.2f}" for axis in at.place_m)
            message = f"No person of this run is within {MAX_DISTANCE_M} m of ({place}) at frame {at.frame}."
            self._refuse(name, message, "Make the edit again on this run, if it is needed.")
        for person in self.people.values():
            piece = piece_at(person.pieces, frame)
            if piece is not None and piece.person == number:
                return person
        message = f"Earlier edits left out person {number} at frame {at.frame}."
        self._refuse(name, message, "Leave out this edit, or the edit that removed the person.")

    def _place(self, person: EditedPerson, near: int | None) -> PersonAt:
        """Place of a person at the known frame nearest to a frame; without one, where others are farthest away."""
        frames: Iterable[int]
        if near is None:
            longest = max(person.pieces, key=lambda piece: piece.stop_frame - piece.start_frame)
            length = longest.stop_frame - longest.start_frame
            steps = sorted(range(1, _NUM_CANDIDATES), key=lambda step: abs(2 * step - _NUM_CANDIDATES))
            frames = [longest.start_frame + length * step // _NUM_CANDIDATES for step in steps]
        else:
            frames = [
                min(
                    (min(max(near, piece.start_frame), piece.stop_frame - 1) for piece in person.pieces),
                    key=lambda frame: (abs(frame - near), -frame),
                )
            ]
        frame = max(frames, key=lambda frame: min(self._apart_m(person, frame), _APART_M))
        x, y, z = (round(axis, 3) for axis in self._found_at(person, frame).place_m(frame))
        if not math.isfinite(x):
            self._refuse("person", f"Person {self._numbers()[person.id]} has no known place.", "Choose another person.")
        return PersonAt(frame=frame + self.frames.start, place_m=(x, y, z))

    def _found_at(self, person: EditedPerson, frame: int) -> PersonSpan:
        """Person of the run who is an edited person at one of their frames."""
        piece = piece_at(person.pieces, frame)
        return self.found[person.id if piece is None else piece.person]

    def _apart_m(self, person: EditedPerson, frame: int) -> float:
        """Distance between a person and the nearest other one at a frame."""
        own = self._found_at(person, frame)
        others = (
            math.dist(own.place_m(frame), other.place_m(frame))
            for other in self.found.values()
            if other is not own and other.start_frame <= frame < other.start_frame + other.num_frames
        )
        return min(others, default=math.inf)

    def _two(self, person: Named, other: Named) -> tuple[EditedPerson, EditedPerson]:
        if isinstance(person, int) and person == other:
            self._refuse("other", f"Person {person} is named twice.", "Name two people.")
        return self._person(person), self._person(other, "other")

    def _normalized(self, name: str) -> str:
        # To normalize long runs of combining characters takes quadratic time.
        is_short = len(name) <= _MAX_SENT_NAME_LENGTH
        stripped = unicodedata.normalize("NFC", name).strip() if is_short else name
        if not 0 < len(stripped) <= MAX_NAME_LENGTH:
            self._refuse("name", f"A name has 1 to {MAX_NAME_LENGTH} characters.", "Choose another name.")
        if any(unicodedata.category(character).startswith("C") for character in stripped):
            self._refuse("name", "Control characters are not allowed in a name.", "Choose another name.")
        if _DEFAULT_NAME.fullmatch(stripped):
            self._refuse("name", f"{stripped} is a name of people without a name.", "Choose another name.")
        return stripped

    def _require_free(self, renamed: EditedPerson, name: str) -> None:
        for person in self.people.values():
            if person is not renamed and person.name and person.name.casefold() == name.casefold():
                self._refuse("name", f"Another person is named {person.name} already.", "Choose another name.")

    def _merge(self, kept: EditedPerson, added: EditedPerson) -> None:
        if kept is added:
            return  # this run has one person there
        pieces = joined(united(kept.pieces, added.pieces))
        self._limit_pieces(len(pieces) - len(kept.pieces) - len(added.pieces))
        del self.people[added.id]
        self.people[kept.id] = replace(
            kept, pieces=pieces, name=kept.name or added.name, described=kept.described or added.described
        )

    def _split(self, person: EditedPerson, session_frame: int, is_placed: bool) -> None:
        frame = session_frame - self.frames.start
        if is_placed and frame == person.start_frame:
            return  # this run has a new person there
        if not person.start_frame < frame < person.stop_frame:
            first, last = (self.frames.start + end for end in (person.start_frame + 1, person.stop_frame - 1))
            hint = f"Choose a frame from {first} to {last}." if first <= last else "It has a single frame."
            message = f"Person {self._numbers()[person.id]} can't be split at frame {session_frame}."
            self._refuse("frame", message, hint)
        parts = within(person.pieces, person.start_frame, frame), within(person.pieces, frame, person.stop_frame)
        self._limit_pieces(sum(map(len, parts)) - len(person.pieces))
        self.last_key += 1
        self.people[person.id] = replace(person, pieces=parts[0])
        self.people[self.last_key] = EditedPerson(self.last_key, parts[1])

    def _exchange(self, first: EditedPerson, second: EditedPerson, frames: range) -> None:
        if first is second:
            return  # this run has one person there
        exchanged = {
            mine.id: chained(
                within(mine.pieces, 0, frames.start),
                within(theirs.pieces, frames.start, frames.stop),
                within(mine.pieces, frames.stop, len(self.frames)),
            )
            for mine, theirs in ((first, second), (second, first))
        }
        if exchanged[first.id] == first.pieces:
            self._refuse("start_frame", "Neither person is there in these frames.", "Choose other frames.")
        self._limit_pieces(sum(map(len, exchanged.values())) - len(first.pieces) - len(second.pieces))
        for person in (first, second):
            if exchanged[person.id]:
                self.people[person.id] = replace(person, pieces=exchanged[person.id])
            else:
                del self.people[person.id]

    def _correct(self, edit: Correction | Accept) -> None:
        """Keep a correction with the body that is there in the frame by which the person is named."""
        person = None if edit.person is None else self._person(edit.person)
        field_name = "frame" if isinstance(edit, KeyJoint | PlaceDetection) else "start_frame"
        start, stop = frames_of(edit)
        here, first = self._range(start, stop), self.frames.start
        for name, known in self.known.items():
            value = getattr(edit, name, None)
            if value is not None and value not in known:
                hint = f"Known are {', '.join(sorted(known))}."
                self._refuse(name, f"This run has no {name} {value}.", hint)
        moved = replace(edit, **{name: getattr(edit, name) - first for name in _FRAMES if hasattr(edit, name)})
        if person is None:
            self.accepted.append(moved)  # only places of cameras are without a person
            return
        if here.stop <= person.start_frame or here.start >= person.stop_frame:
            hint = f"The person is there from frame {first + person.start_frame} on."
            self._refuse(field_name, f"The person is not there at frame {start}.", hint)
        anchor = edit.person.frame - first if isinstance(edit.person, PersonAt) else here.start
        piece = min(person.pieces, key=lambda piece: max(piece.start_frame - anchor, anchor + 1 - piece.stop_frame, 0))
        anchor = min(max(anchor, piece.start_frame), piece.stop_frame - 1)
        if isinstance(edit, KeyJoint):
            distance_m = math.dist(edit.place_m, self.found[piece.person].place_m(here.start))
            if MAX_KEY_M < distance_m < math.inf:
                message = f"The place is {distance_m:.1f} m from the person at frame {start}."
                self._refuse("place_m", message, f"Choose a place within {MAX_KEY_M} m.")
        self.corrections.append((piece.person, anchor, moved))

    def _range(self, start: int, stop: int) -> range:
        """Part of frames of the session that is in the run, numbered from the run's first frame."""
        within = range(max(start, self.frames.start), min(stop, self.frames.stop))
        if not within:
            message = f"The frames {start} to {stop} are not a part of the take."
            hint = f"The take has the frames {self.frames.start} to {self.frames.stop}; the last is excluded."
            self._refuse("stop_frame", message, hint)
        return range(within.start - self.frames.start, within.stop - self.frames.start)

    def _limit_pieces(self, num_more: int) -> None:
        """Refuse an edit after which all people would consist of too many pieces."""
        num_pieces = sum(len(person.pieces) for person in self.people.values()) + num_more
        if num_more > 0 and num_pieces > MAX_PIECES:
            message = f"After this edit the people would consist of {num_pieces:,} pieces; {MAX_PIECES:,} are allowed."
            hint = "Leave this edit out, or exchange people in fewer places."
            raise InputError([Problem(EDITS_FRAGMENTED, message, field=f"edits/{self.number}", hint=hint)])

    def _refuse(self, name: str, message: str, hint: str) -> NoReturn:
        raise InputError([Problem(EDIT_IMPOSSIBLE, message, field=f"edits/{self.number}/{name}", hint=hint)])
