"""Texts of the page: all of them are in one folder, which a translation replaces, and their sentences are short."""

import re
from collections.abc import Iterator
from pathlib import Path

PORTAL = Path(__file__).parents[3] / "api" / "portal"
TEXTS = PORTAL / "shared" / "strings"
MAX_WORDS = 15  # of a sentence, with the names that are put in
# Attributes and nodes of templates, and texts in capitals, as they stand in a line of a module.
LITERALS = (
    r'(?:aria-label|title|placeholder|alt)="([^"$]*[A-Za-z]{2,}[^"]*)"',
    r'"aria-label": "([^"]*)"',
    r"<\w+[^<>`]*>\s*([A-Z][a-z]+[^<>$`]*)[<`$]",
    r'[(\[{ ]"([A-Z][a-z]+ [a-z][^"]*)"',
    r"`([A-Z][a-z]+ [a-z$][^`]*)`",
)
OTHERS = {"mc_…", "Bearer ${identity.secret}"}  # forms of keys


def modules() -> Iterator[Path]:
    for path in PORTAL.rglob("*.js"):
        folder = path.relative_to(PORTAL).parts[0]
        if folder not in {"help", "node_modules", "vendor"} and path.parent != TEXTS:
            yield path


def test_no_text_stands_in_a_template() -> None:
    found = []
    for path in modules():
        for line in path.read_text(encoding="utf-8").splitlines():
            if not re.match(r"\s*(//|\*|/\*)", line):
                texts = [text for literal in LITERALS for text in re.findall(literal, line)]
                found += [(path.name, text) for text in texts if text not in OTHERS]
    assert found == []


def test_sentences_of_texts_are_short() -> None:
    long = []
    for path in TEXTS.glob("*.js"):
        for line in path.read_text(encoding="utf-8").splitlines():
            for texts in re.findall(r'"([^"]+)"|`([^`]+)`', line.partition("// ")[0]):
                text = re.sub(r"\$\{[^{}]*\}", "X", "".join(texts))
                long += [one for one in re.split(r"(?<=[.?:])\s", text) if len(one.split()) > MAX_WORDS]
    assert long == []
