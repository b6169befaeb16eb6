"""The documentation is short where it must be, its links lead somewhere, and every page says what it is for."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from api.cli.client import Client
from api.cli.main import COMMANDS, load
from website import pages

ROOT = Path(__file__).parents[1]
# Pages that are made from the code, by their paths
GENERATED = {pages.FOLDER / name: document for name, document in pages.PAGES.items()}
TEXTS = {
    page: page.read_text(encoding="utf-8")
    for page in (*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md")))
    if page not in GENERATED
} | {page: document() for page, document in GENERATED.items()}
MAX_README_LINES = 90
MAX_README_ROW = 240
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
MAX_WORDS = 40_000
MAX_MEAN_SENTENCE, MAX_SENTENCE = 18, 35
FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)


def prose(text: str) -> str:
    """Text of a page without its blocks of code."""
    return FENCE.sub("", text)


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", prose(text), re.MULTILINE)
    named = re.findall(r"\[\]\(\)\{ #(\S+) \}", text)
    return {*named, *(re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings)}


def broken_links(page: Path, text: str) -> Iterator[str]:
    for target in LINK.findall(prose(text)):
        if re.match(r"[a-z]+:|/", target):
            continue
        path, _, anchor = target.partition("#")
        found = page if path == "" else (page.parent / path).resolve()
        is_there = found == page or found.exists() or found in GENERATED
        if is_there and anchor:
            is_there = anchor in anchors(
                text if found == page else TEXTS.get(found) or found.read_text(encoding="utf-8")
            )
        if not is_there:
            yield target


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    assert list(broken_links(page, TEXTS[page])) == []


def test_generated_pages_are_written_and_ignored(tmp_path: Path) -> None:
    pages.write_pages(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {page.name for page in GENERATED}
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()
    for page in GENERATED:
        assert (tmp_path / page.name).read_text(encoding="utf-8") == TEXTS[page]
        assert f"/{page.relative_to(ROOT).as_posix()}" in ignored


def test_broken_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# Some title: `a_b`, twice\n\n```\n# no heading\n```\n")
    text = (
        "[a](other.md) [b](other.md#some-title-a_b-twice) [c](https://x.example/y.md) ![d](missing.png)\n"
        "[e](other.md#no-heading) [f](#nowhere)\n```\n[g](missing.md)\n```\n"
    )
    assert list(broken_links(tmp_path / "page.md", text)) == ["missing.png", "other.md#no-heading", "#nowhere"]


def test_readme_is_short() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= MAX_README_LINES
    assert [line for line in lines if len(line) > MAX_README_ROW] == []


def sentences(text: str) -> list[list[str]]:
    """Words of each sentence of a page: of paragraphs, of items in lists and of cells of tables."""
    plain = re.sub(r"`[^`]*`", "Code", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", prose(text)))
    blocks = re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=[|#])|(?<= )\|", plain)
    parts = [part for block in blocks for part in re.split(r"(?<=[.!?])\s+(?=[A-Z\d\"(])", " ".join(block.split()))]
    return [words for part in parts if len(words := part.strip("|-* ").split()) > 1 and not part.startswith("#")]


BOOK = [page for page in TEXTS if page not in GENERATED and "lab" not in page.relative_to(ROOT).parts]


@pytest.mark.parametrize("page", BOOK, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_sentences_are_short(page: Path) -> None:
    found = sentences(TEXTS[page])
    assert [" ".join(words) for words in found if len(words) > MAX_SENTENCE] == []
    assert sum(map(len, found)) <= MAX_MEAN_SENTENCE * len(found)


def test_book_is_short() -> None:
    num_words = {page.name: len(TEXTS[page].split()) for page in BOOK if page.parent != ROOT}
    assert sum(num_words.values()) <= MAX_WORDS, num_words


def test_sentences_and_their_words_are_counted() -> None:
    text = "# Title\n\nOne two. Three `a b` four five.\n\n| one | two three |\n| --- | --- |\n\n- six seven\n"
    assert [len(words) for words in sentences(text)] == [2, 4, 2, 2]


@pytest.mark.parametrize(
    "page", [page for page in TEXTS if page.parent.parent == ROOT / "docs"], ids=lambda page: page.name
)
def test_pages_begin_with_what_they_are_for(page: Path) -> None:
    title, blank, first, *_ = TEXTS[page].splitlines()
    assert title.startswith("# ")
    assert blank == ""
    assert first.startswith("This page ")


def test_python_example_calls_client_as_it_is() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    called = []
    for node in ast.walk(ast.parse(block)):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="client"), attr=method), args=arguments):
                inspect.signature(getattr(Client, method)).bind(None, *arguments)
                called.append(method)
    assert sorted(called) == ["download", "follow", "submit"]


def test_options_of_readme_exist() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    for command, options in re.findall(r"multicap (\w+)((?:[^`\n]|\\\n)*)", readme):
        if command not in COMMANDS or "--" not in options:
            continue
        known = option_names(load(command))
        assert set(re.findall(r"--[a-z-]+", options)) <= known | {"--help"}, command


def option_names(command: Any) -> set[str]:
    """Options of a command and of its subcommands."""
    inner = set().union(*(option_names(one) for one in getattr(command, "commands", {}).values()))
    return inner | {name for parameter in command.params for name in parameter.opts}


def test_rooms_have_row_each_in_architecture() -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text("utf-8")
    assert len(page.split()) <= 1_800
    rows = re.findall(r"^\| (.+?) \|", page.partition("\n## Rooms\n")[2].partition("\n## ")[0], re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`([a-z/]+)`", row)}
    rooms = {path for package in ("api", "pipeline", "worker") for path in (ROOT / package).iterdir() if path.is_dir()}
    assert named == {room.relative_to(ROOT).as_posix() for room in rooms if room.name != "__pycache__"} | {
        *("clients/typescript", "multicap")
    }
