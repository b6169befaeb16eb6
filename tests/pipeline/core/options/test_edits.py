"""Edits of people: laws of their application, and refusals that name the edit."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.core.errors import InputError
from pipeline.core.options.edits import (
    MAX_PIECES,
    Cut,
    EditedPerson,
    EditedTake,
    Exchange,
    Merge,
    PeopleEdit,
    PersonSpan,
    Piece,
    Remove,
    Rename,
    Split,
    apply_edits,
    edit_document,
    read_edit,
)

NUM_FRAMES = 30
FOUND = (PersonSpan(1, 0, 30), PersonSpan(2, 5, 10), PersonSpan(3, 18, 12))

numbers, frames = st.integers(1, 5), st.integers(0, NUM_FRAMES)
edits = st.one_of(
    st.builds(Rename, person=numbers, name=st.sampled_from(["Anna", "Bo"])),
    st.builds(Remove, person=numbers),
    st.builds(Merge, person=numbers, other=numbers),
    st.builds(Split, person=numbers, frame=frames),
    st.builds(Exchange, person=numbers, other=numbers, start_frame=frames, stop_frame=st.none() | frames),
    st.builds(Cut, start_frame=frames, stop_frame=frames),
)


def pieces_of(take: EditedTake) -> dict[int, tuple[Piece, ...]]:
    return {person.id: person.pieces for person in take.people}


def apply(*made: PeopleEdit) -> EditedTake:
    return apply_edits(FOUND, made, NUM_FRAMES)


def possible(made: list[PeopleEdit]) -> tuple[PeopleEdit, ...]:
    """Edits of a list, each left out that can't be made after those before it."""
    kept: tuple[PeopleEdit, ...] = ()
    for edit in made:
        try:
            apply(*kept, edit)
        except InputError:
            continue
        kept += (edit,)
    return kept


def test_no_edits_leave_everybody_as_found() -> None:
    assert apply() == EditedTake(
        tuple(
            EditedPerson(one.id, (Piece(one.id, one.start_frame, one.start_frame + one.num_frames),)) for one in FOUND
        )
    )


@given(st.lists(edits, max_size=8))
def test_no_frame_of_found_person_is_in_two_places(made: list[PeopleEdit]) -> None:
    take = apply(*possible(made))
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


@given(st.integers(0, NUM_FRAMES - 1))
def test_two_equal_exchanges_are_none(start_frame: int) -> None:
    exchange = Exchange(person=1, other=3, start_frame=start_frame)
    assert apply(exchange, exchange) == apply()


@given(st.integers(1, NUM_FRAMES - 1))
def test_merge_takes_split_back(frame: int) -> None:
    take = apply(Split(person=1, frame=frame), Merge(person=1, other=4))
    assert take == apply()


def test_merge_prefers_first_person_where_both_are() -> None:
    assert pieces_of(apply(Merge(person=2, other=1)))[2] == (Piece(1, 0, 5), Piece(2, 5, 15), Piece(1, 15, 30))
    assert pieces_of(apply(Merge(person=2, other=3)))[2] == (Piece(2, 5, 15), Piece(3, 18, 30))


def test_exchange_can_end() -> None:
    take = apply(Exchange(person=1, other=2, start_frame=8, stop_frame=12))
    assert pieces_of(take)[1] == (Piece(1, 0, 8), Piece(2, 8, 12), Piece(1, 12, 30))
    assert pieces_of(take)[2] == (Piece(2, 5, 8), Piece(1, 8, 12), Piece(2, 12, 15))


def test_numbers_of_removed_people_are_not_given_again() -> None:
    take = apply(Split(person=1, frame=10), Remove(person=4), Split(person=1, frame=5))
    assert [person.id for person in take.people] == [1, 2, 3, 5]


def test_name_stays_with_person() -> None:
    take = apply(Rename(person=3, name="  Zoë "), Merge(person=2, other=3))
    assert [(person.id, person.name) for person in take.people] == [(1, None), (2, "Zoë")]


def fragmenting(num_edits: int) -> list[PeopleEdit]:
    """Exchanges of two people, each of which adds two pieces to both."""
    return [Exchange(person=1, other=2, start_frame=4 * n + 1, stop_frame=4 * n + 3) for n in range(num_edits)]


def test_work_grows_with_pieces_not_with_their_square(monkeypatch: pytest.MonkeyPatch) -> None:
    made = 0

    class CountedPiece(Piece):
        def __post_init__(self) -> None:
            nonlocal made
            made += 1

    monkeypatch.setattr("pipeline.core.options.edits.Piece", CountedPiece)
    people = (PersonSpan(1, 0, 10_000), PersonSpan(2, 0, 10_000))
    take = apply_edits(people, [*fragmenting(999), Merge(person=1, other=2)], 10_000)
    assert [len(person.pieces) for person in take.people] == [1999]
    assert made < 20 * 1000


def test_pieces_of_new_edits_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    people, made = (PersonSpan(1, 0, 10_000), PersonSpan(2, 0, 10_000)), fragmenting(600)
    with pytest.raises(InputError) as refused:
        apply_edits(people, made, 10_000, MAX_PIECES)
    (problem,) = refused.value.problems
    assert (problem.code, problem.field) == ("edits_fragmented", "edits/499")  # 2 + 4 x 500 pieces
    assert len(apply_edits(people, made[:499], 10_000, MAX_PIECES).people) == 2
    # Edits that an older version stored are applied all the same.
    assert len(apply_edits(people, made, 10_000).people) == 2


def test_long_name_is_refused_before_it_is_normalized(monkeypatch: pytest.MonkeyPatch) -> None:
    # Normalizing a run of combining characters takes quadratic time: minutes for a name of a megabyte.
    normalized: list[int] = []

    def normalize(_: str, name: str) -> str:
        normalized.append(len(name))
        return name

    monkeypatch.setattr("pipeline.core.options.edits.unicodedata.normalize", normalize)
    with pytest.raises(InputError):
        apply(Rename(person=1, name="a" + "\u0316\u0301" * 100_000))
    assert normalized == []


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (Rename(person=9, name="Anna"), "person"),
        (Rename(person=1, name="  "), "name"),
        (Rename(person=1, name="a\nb"), "name"),
        (Rename(person=1, name="a" * 101), "name"),
        (Remove(person=0), "person"),
        (Merge(person=1, other=1), "other"),
        (Merge(person=1, other=7), "other"),
        (Split(person=2, frame=5), "frame"),
        (Split(person=2, frame=15), "frame"),
        (Exchange(person=2, other=3, start_frame=0, stop_frame=5), "start_frame"),
        (Exchange(person=2, other=3, start_frame=9, stop_frame=9), "stop_frame"),
        (Cut(start_frame=20, stop_frame=31), "stop_frame"),
        (Cut(start_frame=-1, stop_frame=3), "stop_frame"),
    ],
)
def test_refusal_names_edit(edit: Any, field: str) -> None:
    with pytest.raises(InputError) as refused:
        apply(Split(person=1, frame=10), edit)
    (problem,) = refused.value.problems
    assert (problem.code, problem.field) == ("edit_impossible", f"edits/1/{field}")
    assert problem.hint
