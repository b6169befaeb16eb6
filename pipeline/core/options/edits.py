"""Edits of people: who is who, put right by hand. Standard library only: the web API imports this module.

Edits are data, and belong to a capture session: every run of it applies them. An edit names a person by a place in the
world at a frame of the session, because another run numbers people otherwise. Each edit is applied to the people that
the earlier edits leave. An edit that can't be applied to a run changes nothing there, and its outcome says why. Edits
that do not concern the same frames of the same people give equal takes in any order. ``edited_take`` applies them.

Corrections are edits of a person's joints. They belong to the body that is there in the frame by which the person is
named, whoever it is after other edits.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Literal, get_args

from pipeline.core.records import from_json

MAX_EDITS = 1000
"""Largest number of edits of a take."""
MAX_NAME_LENGTH = 100
"""Largest number of characters of a person's name."""
MAX_PIECES = 2000
"""Largest number of pieces of which all people of a take may consist."""
MAX_DISTANCE_M = 0.5
"""Largest distance between the place in an edit and the person who is meant."""

LEAST_MASS_KG, MOST_MASS_KG = 1.0, 500.0
MAX_KEY_M = 2.0
"""Largest distance of a key from the middle of the person."""

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
    """Exchange two people from ``start_frame`` on, up to ``stop_frame`` or else to the end.

    A place of ``person`` in the frame before and one of ``other`` in ``start_frame`` change only runs with the fault.
    """

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


class _Correction(_Edit):
    """Base of the corrections."""

    __slots__ = ()
    __pydantic_config__: ClassVar[Mapping[str, Any]] = {
        **_Edit.__pydantic_config__,
        "allow_inf_nan": False,
        "str_max_length": 200,
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyJoint(_Correction):
    """Put a joint of a person at a place in the world (metres) in one frame."""

    action: Literal["key"] = "key"
    person: Named
    joint: str
    frame: int
    place_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class IgnoreDetections(_Correction):
    """Ignore what a camera sees of a person. ``part`` is a joint, an arm, a leg, the ``head``, or ``all``."""

    action: Literal["ignore_detections"] = "ignore_detections"
    person: Named
    camera: str
    part: str
    start_frame: int
    stop_frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceDetection(_Correction):
    """Put a joint's detection to a place in a camera's picture in one frame: pixels of the picture as filmed."""

    action: Literal["place_detection"] = "place_detection"
    person: Named
    camera: str
    joint: str
    frame: int
    place_px: tuple[float, float]


Sides = Literal["arms", "legs", "all"]
"""Joints of both sides that are exchanged."""
Sex = Literal["female", "male", "unstated"]
"""Sex whose masses of segments a person has; unstated: the mean of both."""
Limb = Literal["left_hand", "right_hand", "left_foot", "right_foot"]
"""Hand or foot that touches the floor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExchangeSides(_Correction):
    """Exchange the left and the right side of a person in all cameras.

    ``left_m`` is the middle of the part's left joints in ``start_frame``, as it is right: runs that have the left side
    there stay as they are.
    """

    action: Literal["exchange_sides"] = "exchange_sides"
    person: Named
    part: Sides
    start_frame: int
    stop_frame: int
    left_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact(_Correction):
    """Let a foot or a hand of a person stand, or not."""

    action: Literal["contact"] = "contact"
    person: Named
    limb: Limb
    start_frame: int
    stop_frame: int
    stands: bool


CameraKind = Literal[
    "camera_disagrees",
    "camera_without_people",
    "camera_below_floor",
    "camera_sees_nobody",
    "clocks_disagree",
    "no_common_people",
]
"""Code of a finding about a camera."""
PersonKind = Literal["limb_mismeasured", "person_never_moves", "mirror_image", "stature_out_of_range"]
"""Code of a finding about a person."""
ConcernKind = Literal["error", "identity", "sides", "few_views", "acceleration", PersonKind, CameraKind]
"""Reason to look at a person or at a camera."""
PERSON_KINDS: tuple[PersonKind, ...] = get_args(PersonKind)
CAMERA_KINDS: tuple[CameraKind, ...] = get_args(CameraKind)


@dataclass(frozen=True, slots=True, kw_only=True)
class Accept(_Correction):
    """Say that a person, or else a camera, is right where the take suggests to look."""

    action: Literal["accept"] = "accept"
    person: Named | None = None
    camera: str | None = None
    kind: ConcernKind
    start_frame: int
    stop_frame: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Describe(_Correction):
    """State a person's sex and mass, for masses of segments and momenta; null: as the choices of the job."""

    action: Literal["describe"] = "describe"
    person: Named
    sex: Sex | None = None
    mass_kg: float | None = None


Correction = KeyJoint | IgnoreDetections | PlaceDetection | ExchangeSides | Contact
"""A correction of a person's joints."""
PeopleEdit = Rename | Remove | Merge | Split | Exchange | Cut | Correction | Accept | Describe
"""An edit of people. All frames are frames of the session."""

_BY_ACTION: Mapping[str, Callable[..., PeopleEdit]] = {
    str(fields(kind)[0].default): kind for kind in get_args(PeopleEdit)
}


def frames_of(correction: Correction | Accept) -> tuple[int, int]:
    """First frame of a correction, and the frame after the last one."""
    if isinstance(correction, KeyJoint | PlaceDetection):
        return correction.frame, correction.frame + 1
    return correction.start_frame, correction.stop_frame


def of_motion(edits: Sequence[PeopleEdit]) -> tuple[PeopleEdit, ...]:
    """Edits that say who is where, and corrections of joints; not people's names, masses, and what was looked at."""
    return tuple(edit for edit in edits if not isinstance(edit, Rename | Accept | Describe))


def without_names(edits: Sequence[PeopleEdit]) -> tuple[PeopleEdit, ...]:
    """Edits but for people's names."""
    return tuple(edit for edit in edits if not isinstance(edit, Rename))


def read_edit(document: Mapping[str, Any]) -> PeopleEdit:
    """Edit from its JSON object, as ``edit_document`` makes it."""
    return from_json(_BY_ACTION[document["action"]], document)


def edit_document(edit: PeopleEdit) -> dict[str, Any]:
    """JSON object of an edit."""
    return asdict(edit)
