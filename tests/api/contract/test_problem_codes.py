"""Problem codes are declared once, each with sentences and places; the type checker compares them with the raisers."""

import re

import pytest

from api.contract.problem_codes.page import GROUPS, PAGE, document, main
from api.errors import _CODES
from pipeline.problem_codes.model import ProblemCode, status_of

CODES = [code for group in GROUPS for code in group.codes]
PLACES = {"job", "waiting", "attempt", "readyz", "command", "warning", "finding"}


def test_codes_are_declared_once() -> None:
    names = [code.name for code in CODES]
    assert len(names) > 250
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize("code", CODES, ids=lambda code: code.name)
def test_entries_are_sentences_and_places(code: ProblemCode) -> None:
    assert re.fullmatch(r"[a-z]+(_[a-z0-9]+)*", code.name)
    assert code.meaning.endswith(".")
    assert code.remedy.endswith(".")
    assert "|" not in code.meaning + code.remedy
    assert code.where
    assert all(place in PLACES or re.fullmatch(r"4\d\d|5\d\d", place) for place in code.where)


def test_errors_of_the_framework_have_their_statuses() -> None:
    assert {status_of(code): code for code in _CODES.values()} == dict(_CODES)


def test_page_is_what_the_code_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert PAGE.read_text(encoding="utf-8") == document()
    assert main(["--check"]) == 0
    assert capsys.readouterr().err == ""
