"""``python -m website.pages``: write the pages of ``docs/reference`` that are made from the code; git ignores them."""

from collections.abc import Callable, Mapping

import typer
from typer.cli import get_docs_for_click

import multicap
from api.cli.main import COMMANDS, load
from api.web.contract import documentation
from website import operations

_COMMANDS = """\
# Command line

This page lists every command of `multicap` with its arguments and options. `multicap COMMAND --help` shows the same.
"""
_MADE = "This page is made from the code: `make docs` writes it."


def commands() -> str:
    """Write the page of the command line: every command with its arguments and options."""
    pages = [f"{_COMMANDS}\n{_MADE}\n"]
    for name in COMMANDS:
        command = load(name)
        context = typer.Context(command, info_name=f"multicap {name}")
        pages.append(get_docs_for_click(obj=command, ctx=context, indent=1, name=f"multicap {name}"))
    return "\n".join(pages)


def names() -> str:
    """Write the page of the names that ``import multicap`` has; the site puts their docstrings there."""
    head = f"# Python names\n\nThis page lists the public names of the package `multicap`.\n\n{_MADE}\n"
    return "\n".join([head, *(f"::: multicap.{name}\n" for name in multicap.__all__)])


PAGES: Mapping[str, Callable[[], str]] = {
    **documentation.PAGES,
    "cli.md": commands,
    "http-operations.md": operations.document,
    "python-names.md": names,
}
"""Texts of the pages by their names."""


if __name__ == "__main__":
    for page, document in PAGES.items():
        (documentation.FOLDER / page).write_text(document(), encoding="utf-8")
