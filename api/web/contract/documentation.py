"""``python -m api.web.contract.documentation``: write the pages of ``docs/reference`` that are made from the code."""

from collections.abc import Callable, Mapping
from pathlib import Path

from api.web.contract import options_page, problems_page, reader_tables_page, settings_page

FOLDER = Path(__file__).parents[3] / "docs" / "reference"
PAGES: Mapping[str, Callable[[], str]] = {
    "options.md": options_page.document,
    "problems.md": problems_page.document,
    "reader-tables.md": reader_tables_page.document,
    "settings.md": settings_page.document,
}
"""Texts of the pages by their names; git ignores these files."""


def write_pages(folder: Path) -> None:
    """Write the pages as Markdown."""
    for name, document in PAGES.items():
        (folder / name).write_text(document(), encoding="utf-8")


if __name__ == "__main__":
    write_pages(FOLDER)
