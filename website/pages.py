"""``python -m website.pages``: write the pages of ``docs/reference`` that are made from the code; git ignores them."""

from collections.abc import Callable, Mapping
from pathlib import Path

import typer
from typer.cli import get_docs_for_click

import multicap
from api.cli.main import COMMANDS, load
from website import operations_page, options_page, problems_page, reader_tables_page, settings_page

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
_COMMANDS = """\
# Command line

This page lists every command of `multicap` with its arguments and options. `multicap COMMAND --help` shows the same.
"""
_NAMES = """\
# Python names

This page lists the public names of the package `multicap`.
"""


def commands() -> str:
    """Write the page of the command line: every command with its arguments and options."""
    texts = [_COMMANDS]
    for name in COMMANDS:
        command = load(name)
        context = typer.Context(command, info_name=f"multicap {name}")
        texts.append(get_docs_for_click(obj=command, ctx=context, indent=1, name=f"multicap {name}"))
    return "\n".join(texts)


def names() -> str:
    """Write the page of the names that ``import multicap`` has; the site puts their docstrings there."""
    return "\n".join([_NAMES, *(f"::: multicap.{name}\n" for name in multicap.__all__)])


PAGES: Mapping[str, Callable[[], str]] = {
    "cli.md": commands,
    "http-operations.md": operations_page.document,
    "options.md": options_page.document,
    "problems.md": problems_page.document,
    "python-names.md": names,
    "reader-tables.md": reader_tables_page.document,
    "settings.md": settings_page.document,
}
"""Texts of the pages by their names."""


def write_pages(folder: Path) -> None:
    """Write the pages as Markdown."""
    for name, document in PAGES.items():
        (folder / name).write_text(document(), encoding="utf-8")


if __name__ == "__main__":
    write_pages(FOLDER)
