"""Problem codes are declared once, each with sentences and places; the type checker compares them with the raisers."""

import ast
import importlib
import pkgutil
import re
from pathlib import Path
from typing import get_args

import pytest

import pipeline.core.problems
from api.web.errors import _CODES
from pipeline.core.problems.code_group import Code, Place, usual_status
from website.problems_page import GROUPS, SENTENCES, document

CODES = [(code, places) for group in GROUPS for code, places in group.places.items()]
ROOT = Path(__file__).parents[2]
PLACES = get_args(Place)


def test_codes_are_declared_once() -> None:
    names = [code for code, _ in CODES]
    assert len(names) > 250
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize(("code", "places"), CODES, ids=[code for code, _ in CODES])
def test_entries_are_sentences_and_places(code: Code, places: tuple[int | Place, ...]) -> None:
    assert re.fullmatch(r"[a-z]+(_[a-z0-9]+)*", code)
    meaning, remedy = SENTENCES[code]
    assert meaning.endswith(".")
    assert remedy.endswith(".")
    assert "|" not in meaning + remedy
    assert places
    assert all(place in PLACES or (isinstance(place, int) and 400 <= place < 600) for place in places)


def test_every_code_has_use() -> None:
    """A code is dead that no module imports and names."""
    dead = set()
    for module in pkgutil.iter_modules(pipeline.core.problems.__path__, "pipeline.core.problems."):
        constants = vars(importlib.import_module(module.name)).items()
        dead |= {(module.name, name) for name, value in constants if name.isupper() and isinstance(value, str)}
    assert len(dead) == len(CODES)
    for package in ("api", "multicap", "pipeline", "worker"):
        for path in (ROOT / package).rglob("*.py"):
            source = path.read_bytes()
            if b"pipeline.core.problems" not in source:
                continue
            nodes = [*ast.walk(ast.parse(source))]
            named = {node.id for node in nodes if isinstance(node, ast.Name)}
            read = {
                (node.value.id, node.attr)
                for node in nodes
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            }
            for node in nodes:
                if isinstance(node, ast.ImportFrom):
                    dead -= {(node.module, known.name) for known in node.names if (known.asname or known.name) in named}
                    modules = {known.name for known in node.names if node.module == "pipeline.core.problems"}
                    dead -= {(f"{node.module}.{module}", name) for module, name in read if module in modules}
    assert not dead


def test_errors_of_framework_have_their_statuses() -> None:
    assert {usual_status(code): code for code in _CODES.values()} == dict(_CODES)


def test_page_has_row_for_every_code() -> None:
    rows = re.findall(
        r"^\| \[\]\(\)\{ #[a-z0-9_]+ \}`([a-z0-9_]+)` \| (.+?) \| (.+?) \| (.+?) \|$", document(), re.MULTILINE
    )
    assert rows == [(code, ", ".join(map(str, places)), *SENTENCES[code]) for code, places in CODES]
