"""Wrong arguments of public functions: each gets a sentence, and all come at once."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Annotated, Any, Literal

import pytest

from multicap import InputError
from pipeline.core.options.arguments import checked, wrong_values
from pipeline.core.options.choices import Value, plain_hint

Kind = Annotated[Literal["bvh"], Value("BVH")] | Annotated[Literal["csv"], Value("CSV")]
CALLS: list[tuple[Any, ...]] = []


@checked
def write(
    take: Collection[int],
    kinds: Collection[Kind] = (),
    rate_hz: float | None = None,
    on: Callable[[], None] | None = None,
) -> None:
    CALLS.append((take, kinds, rate_hz, on))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"take": 5}, "take must be a list, each item a whole number, not 5."),
        ({"take": [True]}, "take must be a list, each item a whole number, not [True]."),
        ({"kinds": "bvh"}, "kinds must be a list, each item one of bvh, csv, not 'bvh'."),
        ({"kinds": ["fbx"]}, "kinds must be a list, each item one of bvh, csv, not ['fbx']."),
        ({"rate_hz": "30"}, "rate_hz must be a number, or None, not '30'."),
        ({"on": 1}, "on must be a function, or None, not 1."),
    ],
)
def test_wrong_argument_gets_sentence(arguments: dict[str, Any], sentence: str) -> None:
    CALLS.clear()
    with pytest.raises(InputError) as caught:
        write(**{"take": [1], **arguments})
    assert [problem.message for problem in caught.value.problems] == [sentence]
    assert not CALLS


def test_all_wrong_arguments_come_at_once() -> None:
    with pytest.raises(InputError) as caught:
        write("x", 3, "x")  # type: ignore[arg-type]
    assert [problem.field for problem in caught.value.problems] == ["take", "kinds", "rate_hz"]


def test_right_arguments_reach_function() -> None:
    CALLS.clear()
    write((1,), {"csv"}, 3, print)
    assert [((1,), {"csv"}, 3, print)] == CALLS


def test_types_without_labels_are_one_literal() -> None:
    assert plain_hint(Collection[Kind]) == Collection[Literal["bvh", "csv"]]
    assert plain_hint(Kind | None) == Literal["bvh", "csv"] | None


def test_text_is_no_list_and_types_as_text_are_skipped() -> None:
    hints = {"names": Sequence[str], "table": Mapping[str, int], "ax": "Axes | None", "any": Any}
    assert [problem.field for problem in wrong_values(hints, {"names": "a", "table": [], "ax": 3, "any": 3})] == [
        "names",
        "table",
    ]
