"""Edits of people: laws of their application, and refusals that name the edit."""

import json
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import InputError
from pipeline.core.options.edit_pieces import Piece
from pipeline.core.options.edited_take import EditedPerson, EditedTake, apply_edits, place_edits
from pipeline.core.options.edits import (
    MAX_PIECES,
    Accept,
    Cut,
    Describe,
    Exchange,
    IgnoreDetections,
    KeyJoint,
    Merge,
    PeopleEdit,
    PersonAt,
    PersonSpan,
    PlaceDetection,
    Remove,
    Rename,
    Split,
    edit_document,
    read_edit,
)

NUM_FRAMES = 30
FRAMES = range(NUM_FRAMES)
# They walk along x, three metres apart from each other.
FOUND = (
    PersonSpan(1, 0, 30, ((0, 0.0, 0.0, 1.0), (29, 2.9, 0.0, 1.0))),
    PersonSpan(2, 5, 10, ((5, 0.5, 3.0, 1.0), (14, 1.4, 3.0, 1.0))),
    PersonSpan(3, 18, 12, ((18, 1.8, 6.0, 1.0), (29, 2.9, 6.0, 1.0))),
)


def at(person: int, frame: int) -> PersonAt:
    return PersonAt(frame=frame, place_m=(frame / 10, 3.0 * (person - 1), 1.0))


numbers, frames = st.integers(1, 5), st.integers(0, NUM_FRAMES)
named = numbers | st.builds(at, st.integers(1, 4), frames)
edits = st.one_of(
    st.builds(Rename, person=named, name=st.sampled_from(["Anna", "Bo"])),
    st.builds(Remove, person=named),
    st.builds(Merge, person=named, other=named),
    st.builds(Split, person=named, frame=frames),
    st.builds(Exchange, person=named, other=named, start_frame=frames, stop_frame=st.none() | frames),
    st.builds(Cut, start_frame=frames, stop_frame=frames),
    st.builds(KeyJoint, person=named, joint=st.just("left_wrist"), frame=frames, place_m=st.just((1.0, 0.5, 1.0))),
    st.builds(
        IgnoreDetections,
        person=named,
        camera=st.just("cam"),
        part=st.just("all"),
        start_frame=frames,
        stop_frame=frames,
    ),
    st.builds(
        PlaceDetection,
        person=named,
        camera=st.just("cam"),
        joint=st.just("nose"),
        frame=frames,
        place_px=st.just((1.0, 2.5)),
    ),
    st.builds(Describe, person=named, sex=st.sampled_from(["male", None]), mass_kg=st.sampled_from([60.0, None])),
    st.builds(Accept, person=named, kind=st.just("sides"), start_frame=frames, stop_frame=frames),
)


def pieces_of(take: EditedTake) -> dict[int, tuple[Piece, ...]]:
    return {person.id: person.pieces for person in take.people}


def apply(*made: PeopleEdit) -> EditedTake:
    return apply_edits(FOUND, made, FRAMES)


def who(take: EditedTake) -> tuple[Any, ...]:
    """People and kept frames of a take, without the outcomes of its edits."""
    return take.people, take.frames


def test_no_edits_leave_everybody_as_found() -> None:
    assert apply() == EditedTake(
        tuple(
            EditedPerson(one.id, (Piece(one.id, one.start_frame, one.start_frame + one.num_frames),)) for one in FOUND
        )
    )


@given(st.lists(edits, max_size=8))
def test_no_frame_of_found_person_is_in_two_places(made: list[PeopleEdit]) -> None:
    take = apply(*made)
    seen = [
        (piece.person, frame)
        for person in take.people
        for piece in person.pieces
        for frame in range(piece.start_frame, piece.stop_frame)
    ]
    assert len(seen) == len(set(seen))
    for person in take.people:
        ends = [0, *(end for piece in person.pieces for end in (piece.start_frame, piece.stop_frame))]
        assert ends == sorted(ends)
        assert all(piece.start_frame < piece.stop_frame for piece in person.pieces)


@given(st.lists(edits, max_size=8))
def test_edits_pass_through_json(made: list[PeopleEdit]) -> None:
    assert [read_edit(json.loads(json.dumps(edit_document(edit)))) for edit in made] == made
    assert [read_edit(edit_document(edit)) for edit in made] == made


@given(st.integers(0, NUM_FRAMES - 1))
def test_two_equal_exchanges_are_none(start_frame: int) -> None:
    exchange = Exchange(person=1, other=3, start_frame=start_frame)
    assert who(apply(exchange, exchange)) == who(apply())


@given(st.integers(1, NUM_FRAMES - 1))
def test_merge_takes_split_back(frame: int) -> None:
    take = apply(Split(person=1, frame=frame), Merge(person=1, other=4))
    assert who(take) == who(apply())


def test_merge_prefers_first_person_where_both_are() -> None:
    assert pieces_of(apply(Merge(person=2, other=1)))[2] == (Piece(1, 0, 5), Piece(2, 5, 15), Piece(1, 15, 30))
    assert pieces_of(apply(Merge(person=2, other=3)))[2] == (Piece(2, 5, 15), Piece(3, 18, 30))


def test_exchange_can_end() -> None:
    take = apply(Exchange(person=1, other=2, start_frame=8, stop_frame=12))
    assert pieces_of(take)[1] == (Piece(1, 0, 8), Piece(2, 8, 12), Piece(1, 12, 30))
    assert pieces_of(take)[2] == (Piece(2, 5, 8), Piece(1, 8, 12), Piece(2, 12, 15))


def test_new_people_are_numbered_by_their_first_frames() -> None:
    late, early = Split(person=at(1, 20), frame=20), Split(person=at(1, 10), frame=10)
    take = apply(late, early)
    assert pieces_of(take) == {
        1: (Piece(1, 0, 10),),
        2: (Piece(2, 5, 15),),
        3: (Piece(3, 18, 30),),
        4: (Piece(1, 10, 20),),
        5: (Piece(1, 20, 30),),
    }
    assert who(apply(early, late)) == who(take)


def test_name_stays_with_person() -> None:
    take = apply(Rename(person=3, name="  Zoë "), Merge(person=2, other=3))
    assert [(person.id, person.name) for person in take.people] == [(1, None), (2, "Zoë")]


def test_mass_stays_with_person_and_last_statement_counts() -> None:
    heavy, light = Describe(person=1, sex="male", mass_kg=90.0), Describe(person=2, mass_kg=50.0)
    take = apply(heavy, light, Describe(person=2, sex="female", mass_kg=55.0), Merge(person=3, other=2))
    stated = {person.id: person.described for person in take.people}
    assert stated == {
        1: Describe(person=0, sex="male", mass_kg=90.0),
        3: Describe(person=0, sex="female", mass_kg=55.0),
    }


def fragmenting(num_edits: int) -> list[PeopleEdit]:
    """Exchanges of two people, each of which adds two pieces to both."""
    return [Exchange(person=1, other=2, start_frame=4 * n + 1, stop_frame=4 * n + 3) for n in range(num_edits)]


def test_work_grows_with_pieces_not_with_their_square(monkeypatch: pytest.MonkeyPatch) -> None:
    made = 0

    class CountedPiece(Piece):
        def __post_init__(self) -> None:
            nonlocal made
            made += 1

    monkeypatch.setattr("pipeline.core.options.edited_take.Piece", CountedPiece)
    people = (PersonSpan(1, 0, 10_000), PersonSpan(2, 0, 10_000))
    take = apply_edits(people, [*fragmenting(499), Merge(person=1, other=2)], range(10_000))
    assert [len(person.pieces) for person in take.people] == [999]
    assert made < 20 * 500


def test_edit_that_fragments_people_is_not_applied() -> None:
    people, made = (PersonSpan(1, 0, 10_000), PersonSpan(2, 0, 10_000)), fragmenting(600)
    take = apply_edits(people, made, range(10_000))
    assert sum(len(person.pieces) for person in take.people) == MAX_PIECES - 2  # 2 + 4 x 499 pieces
    problems = [outcome.problem for outcome in take.outcomes]
    assert problems[:499] == [None] * 499
    assert {problem and problem.code for problem in problems[499:]} == {"edits_fragmented"}


def test_long_name_is_refused_before_it_is_normalized(monkeypatch: pytest.MonkeyPatch) -> None:
    # Normalizing a run of combining characters takes quadratic time: minutes for a name of a megabyte.
    normalized: list[int] = []

    def normalize(_: str, name: str) -> str:
        normalized.append(len(name))
        return name

    monkeypatch.setattr("pipeline.core.options.edited_take.unicodedata.normalize", normalize)
    assert apply(Rename(person=1, name="a" + "\u0316\u0301" * 100_000)).outcomes[0].problem is not None
    assert normalized == []


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (Rename(person=9, name="Anna"), "person"),
        (Rename(person=1, name="  "), "name"),
        (Rename(person=1, name="a\nb"), "name"),
        (Rename(person=1, name="a" * 101), "name"),
        (Rename(person=1, name="Person-7"), "name"),
        (Rename(person=1, name=" \u017dOE"), "name"),
        (Remove(person=0), "person"),
        (Merge(person=1, other=1), "other"),
        (Merge(person=1, other=7), "other"),
        (Split(person=2, frame=5), "frame"),
        (Split(person=2, frame=15), "frame"),
        (Exchange(person=2, other=3, start_frame=0, stop_frame=5), "start_frame"),
        (Exchange(person=2, other=3, start_frame=9, stop_frame=9), "stop_frame"),
        (Cut(start_frame=9, stop_frame=9), "stop_frame"),
        (Cut(start_frame=-1, stop_frame=3), "stop_frame"),
        (Describe(person=1, mass_kg=0.5), "mass_kg"),
        (Describe(person=1, mass_kg=501.0), "mass_kg"),
    ],
)
def test_refusal_names_edit(edit: Any, field: str) -> None:
    with pytest.raises(InputError) as refused:
        place_edits(FOUND, [Rename(person=3, name="\u017eoe"), Split(person=1, frame=10), edit], FRAMES)
    (problem,) = refused.value.problems
    assert (problem.code, problem.field) == ("edit_impossible", f"edits/2/{field}")
    assert problem.hint


@given(st.lists(edits, max_size=8))
def test_places_stand_for_numbers(made: list[PeopleEdit]) -> None:
    try:
        placed = place_edits(FOUND, made, FRAMES)
    except InputError:
        return
    assert not any(isinstance(getattr(edit, name, None), int) for edit in placed for name in ("person", "other"))
    assert apply(*placed) == apply(*made)


@given(st.lists(edits, max_size=8), st.integers(1, 1000))
def test_run_of_some_frames_gets_same_people(made: list[PeopleEdit], first: int) -> None:
    # The same run, as if the session had more frames before it.
    def later(edit: PeopleEdit) -> PeopleEdit:
        moved = {name: getattr(edit, name) + first for name in ("frame", "start_frame") if hasattr(edit, name)}
        if getattr(edit, "stop_frame", None) is not None:
            moved["stop_frame"] = edit.stop_frame + first  # type: ignore[union-attr, operator]
        for name in ("person", "other"):
            if isinstance(person := getattr(edit, name, None), PersonAt):
                moved[name] = replace(person, frame=person.frame + first)
        return replace(edit, **moved)

    moved = apply_edits(FOUND, list(map(later, made)), range(first, first + NUM_FRAMES))
    assert who(moved) == who(apply(*made))


OF_ONE = st.one_of(
    st.tuples(st.just("rename"), st.integers(0, 9)),
    st.tuples(st.just("remove"), st.integers(0, 9)),
    st.tuples(st.just("split"), st.integers(1, 8)),
)


@given(
    st.lists(st.tuples(st.integers(1, 40), st.lists(OF_ONE, max_size=4)), unique_by=lambda item: item[0]), st.randoms()
)
def test_edits_of_different_people_give_same_take_in_any_order(
    of_people: list[tuple[int, list[tuple[str, int]]]], random: Random
) -> None:
    """Forty people in two runs, which number and place them otherwise; edits of one person keep their order."""
    runs = [
        [
            PersonSpan(41 - number if is_other else number, number, 10, ((number, 2.0 * number, 0.1 * is_other, 1.0),))
            for number in range(1, 41)
        ]
        for is_other in (False, True)
    ]

    def edit_of(number: int, action: str, frame: int) -> PeopleEdit:
        person = PersonAt(frame=number + frame, place_m=(2.0 * number, 0.0, 1.0))
        match action:
            case "rename":
                return Rename(person=person, name=f"Name {number} {frame}")
            case "remove":
                return Remove(person=person)
            case _:
                return Split(person=person, frame=number + frame)

    queues = [[edit_of(number, *edit) for edit in own] for number, own in of_people]
    in_order = [edit for queue in queues for edit in queue]
    mixed = []
    while waiting := [queue for queue in queues if queue]:
        mixed.append(random.choice(waiting).pop(0))
    for run in runs:
        assert who(apply_edits(run, mixed, range(60))) == who(apply_edits(run, in_order, range(60)))
    ours, theirs = (
        sorted(
            (person.name or "", person.start_frame, person.stop_frame)
            for person in apply_edits(run, mixed, range(60)).people
        )
        for run in runs
    )
    assert ours == theirs


def test_edit_without_person_near_is_kept_and_told() -> None:
    away = Remove(person=PersonAt(frame=10, place_m=(1.0, 0.6, 1.0)))
    take = apply(away, Rename(person=at(1, 10), name="Anna"))
    told, applied = take.outcomes
    assert told.problem is not None
    assert "within 0.5 m of (1.00, 0.60, 1.00) at frame 10" in told.problem.message
    assert (told.person, applied.person, applied.problem) == (None, 1, None)
    assert [person.name for person in take.people] == ["Anna", None, None]


def test_person_is_named_by_frame_after_earlier_edits() -> None:
    exchange = Exchange(person=at(1, 20), other=at(3, 20), start_frame=20)
    take = apply(
        exchange, Rename(person=at(1, 25), name="Anna"), Remove(person=at(2, 6)), Rename(person=at(2, 6), name="Bo")
    )
    assert [(person.id, person.name) for person in take.people] == [(1, None), (3, "Anna")]
    gone = take.outcomes[3].problem
    assert gone is not None
    assert gone.message == "Earlier edits left out person 2 at frame 6."


def test_merge_and_split_that_a_run_has_already_are_applied() -> None:
    take = apply(Merge(person=at(1, 3), other=at(1, 20)), Split(person=at(2, 5), frame=5))
    assert who(take) == who(apply())
    assert [outcome.problem for outcome in take.outcomes] == [None, None]


def test_exchange_that_a_run_has_right_changes_nothing() -> None:
    swapped = [
        PersonSpan(1, 0, 30, ((0, 0.0, 0.0, 1.0), (14, 1.4, 0.0, 1.0), (15, 1.5, 3.0, 1.0), (29, 2.9, 3.0, 1.0))),
        PersonSpan(2, 0, 30, ((0, 0.0, 3.0, 1.0), (14, 1.4, 3.0, 1.0), (15, 1.5, 0.0, 1.0), (29, 2.9, 0.0, 1.0))),
    ]
    right = [PersonSpan(k + 1, 0, 30, ((0, 0.0, 3.0 * k, 1.0), (29, 2.9, 3.0 * k, 1.0))) for k in range(2)]
    edits = place_edits(swapped, [Exchange(person=1, other=2, start_frame=15)], FRAMES)
    assert edits == (Exchange(person=at(1, 14), other=at(1, 15), start_frame=15),)
    assert pieces_of(apply_edits(swapped, edits, FRAMES))[1] == (Piece(1, 0, 15), Piece(2, 15, 30))
    take = apply_edits(right, edits, FRAMES)
    assert (pieces_of(take)[1], take.outcomes[0].problem) == ((Piece(1, 0, 30),), None)


def test_place_is_taken_where_others_are_far() -> None:
    crossing = (
        PersonSpan(1, 0, 80, ((0, 0.0, 0.0, 1.0), (79, 8.0, 0.0, 1.0))),
        PersonSpan(2, 0, 80, ((0, 8.0, 0.0, 1.0), (79, 0.0, 0.0, 1.0))),
    )
    (placed,) = place_edits(crossing, [Remove(person=1)], range(80))
    assert placed == Remove(person=PersonAt(frame=30, place_m=(3.038, 0.0, 1.0)))


def key(number: int, named_at: int) -> KeyJoint:
    person = at(number, named_at)
    return KeyJoint(person=person, joint="left_wrist", frame=named_at, place_m=person.place_m)


def test_correction_stays_with_body_whatever_is_exchanged() -> None:
    exchange = Exchange(person=at(1, 7), other=at(2, 7), start_frame=5, stop_frame=12)
    for made in ((key(1, 8), exchange), (exchange, key(1, 8))):
        corrected = {person.id: len(person.corrections) for person in apply(*made).people}
        assert corrected == {1: 0, 2: 1, 3: 0}


def test_corrections_have_numbers_of_frames_of_the_run() -> None:
    ignore = IgnoreDetections(person=at(1, 14), camera="a", part="all", start_frame=12, stop_frame=16)
    shorter = (PersonSpan(1, 0, 20, tuple((frame - 10, x, y, z) for frame, x, y, z in FOUND[0].places)),)
    (person,) = apply_edits(shorter, [key(1, 14), ignore], range(10, 30)).people
    first, second = person.corrections
    assert isinstance(first, KeyJoint)
    assert isinstance(second, IgnoreDetections)
    assert (first.frame, second.start_frame, second.stop_frame) == (4, 2, 6)


@pytest.mark.parametrize(
    ("correction", "message"),
    [
        (replace(key(2, 8), frame=20), "The person is not there at frame 20."),
        (replace(key(1, 8), frame=300), "The frames 300 to 301 are not a part of the take."),
        (replace(key(1, 8), joint="left_toe"), "This run has no joint left_toe."),
        (replace(key(1, 8), place_m=(9.0, 0.0, 1.0)), "The place is 8.2 m from the person at frame 8."),
        (
            PlaceDetection(person=at(1, 8), camera="b", joint="left_wrist", frame=8, place_px=(1.0, 2.0)),
            "This run has no camera b.",
        ),
    ],
)
def test_correction_that_no_longer_applies_is_told(correction: PeopleEdit, message: str) -> None:
    known = {"camera": ["a"], "joint": ["left_wrist"]}
    take = apply_edits(FOUND, [correction, key(1, 8)], FRAMES, known)
    first, second = take.outcomes
    assert first.problem is not None
    assert first.problem.message == message
    assert second.problem is None
    assert [len(person.corrections) for person in take.people] == [1, 0, 0]


def test_numbers_in_corrections_become_places() -> None:
    (placed,) = place_edits(FOUND, [replace(key(2, 9), person=2)], FRAMES)
    assert isinstance(placed, KeyJoint)
    assert placed.person == at(2, 9)
