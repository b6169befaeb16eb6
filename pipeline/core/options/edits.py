"""Edits of people: who is who, put right by hand. Standard library only: the web API imports this module.

Edits are data, and belong to a capture session: every run of it applies them. An edit names a person by a place in the
world at a frame of the session, because another run numbers people otherwise. Each edit is applied to the people that
the earlier edits leave. An edit that can't be applied to a run changes nothing there, and its outcome says why. Edits
that do not concern the same frames of the same people give equal takes in any order. ``edited_take`` applies them.
"""

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Literal

MAX_EDITS = 1000
"""Largest number of edits of a take."""
MAX_NAME_LENGTH = 100
"""Largest number of characters of a person's name."""
MAX_PIECES = 2000
"""Largest number of pieces of which all people of a take may consist."""
MAX_DISTANCE_M = 0.5
"""Largest distance between the place in an edit and the person who is meant."""

_NOWHERE = math.inf, math.inf, math.inf


@dataclass(frozen=True, slots=True)
class PersonSpan:
    """A person of a run, with the frames from the first to the last one, numbered from the first frame of the run."""

    id: int
    start_frame: int
    num_frames: int
    # Places of the body's centre in the world, ``(frame, x, y, z)`` in metres, ascending; between two of them it moves
    # about evenly. Empty: the person is named by number alone.
    places: tuple[tuple[int, float, float, float], ...] = ()

    def place_m(self, frame: int) -> tuple[float, float, float]:
        """Place at a frame; before the first known place and after the last one, that place. Infinite without any."""
        if not self.places:
            return _NOWHERE
        after = bisect_left(self.places, frame, key=lambda place: place[0])
        if after == 0:
            return self.places[0][1:]
        if after == len(self.places):
            return self.places[-1][1:]
        (start, *first), (stop, *last) = self.places[after - 1 : after + 1]
        share = (frame - start) / (stop - start)
        x, y, z = (a + share * (b - a) for a, b in zip(first, last, strict=True))
        return x, y, z


@dataclass(frozen=True, slots=True, kw_only=True)
class PersonAt:
    """A person by a place: the person of a run nearest to it at a frame of the session, at most 0.5 m away."""

    __pydantic_config__: ClassVar[Mapping[str, Any]] = {"extra": "forbid", "allow_inf_nan": False}

    frame: int
    place_m: tuple[float, float, float]


Named = PersonAt | int
"""A person by a place, or by the number that the run at hand gives after the earlier edits."""


def _require_action(schema: dict[str, Any]) -> None:
    schema["required"] = ["action", *schema["required"]]


class _Edit:
    """Base of the edits."""

    __slots__ = ()
    # The web API's parser refuses unknown fields, and finds the kind of an edit by its action.
    __pydantic_config__: ClassVar[Mapping[str, Any]] = {"extra": "forbid", "json_schema_extra": _require_action}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rename(_Edit):
    """Give a person a name that no other person has."""

    action: Literal["rename"] = "rename"
    person: Named
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove(_Edit):
    """Remove a person from the take."""

    action: Literal["remove"] = "remove"
    person: Named


@dataclass(frozen=True, slots=True, kw_only=True)
class Merge(_Edit):
    """Make one person of two. ``person`` stays; in frames of both, ``person`` counts and ``other`` is left out."""

    action: Literal["merge"] = "merge"
    person: Named
    other: Named


@dataclass(frozen=True, slots=True, kw_only=True)
class Split(_Edit):
    """Make two people of one. From ``frame`` on it is a new person."""

    action: Literal["split"] = "split"
    person: Named
    frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange(_Edit):
    """Exchange two people from ``start_frame`` on, up to ``stop_frame`` or else to the end."""

    action: Literal["exchange"] = "exchange"
    person: Named
    other: Named
    start_frame: int
    stop_frame: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Cut(_Edit):
    """Keep the frames from ``start_frame`` to the one before ``stop_frame`` alone."""

    action: Literal["cut"] = "cut"
    start_frame: int
    stop_frame: int


PeopleEdit = Rename | Remove | Merge | Split | Exchange | Cut
"""An edit of people. All frames are frames of the session."""

_BY_ACTION: Mapping[str, type[PeopleEdit]] = {
    "rename": Rename,
    "remove": Remove,
    "merge": Merge,
    "split": Split,
    "exchange": Exchange,
    "cut": Cut,
}


def without_names(edits: Sequence[PeopleEdit]) -> tuple[PeopleEdit, ...]:
    """Edits that say who is where; people's names are left out."""
    return tuple(edit for edit in edits if not isinstance(edit, Rename))


def read_edit(document: Mapping[str, Any]) -> PeopleEdit:
    """Edit from its JSON object, as ``edit_document`` makes it."""
    people = {
        name: PersonAt(frame=named["frame"], place_m=tuple(named["place_m"]))
        for name in ("person", "other")
        if isinstance(named := document.get(name), Mapping)
    }
    return _BY_ACTION[document["action"]](**{**document, **people})


def edit_document(edit: PeopleEdit) -> dict[str, Any]:
    """JSON object of an edit."""
    return asdict(edit)
