"""Tables of formats: in docs/reference/formats.md, and their rows in the docstrings of readers."""

import ast
import re
from pathlib import Path
from types import ModuleType

_DOCUMENT = Path(__file__).parents[2] / "docs/reference/formats.md"


def documented_rows(readers: ModuleType, head: str) -> list[str]:
    """Rows in the docstrings of a folder's modules, each with as many cells as the head of the table."""
    rows: list[str] = []
    for path in Path(readers.__path__[0]).glob("*.py"):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        _, _, table = text.partition("Rows of the table of formats:")
        rows += re.findall(rf"\|(?:[^|]*\|){{{head.count('|') - 1}}}", " ".join(table.split()))
    return sorted(rows)


def table_rows(head: str) -> list[str]:
    """Rows of the table with a head."""
    text = _DOCUMENT.read_text(encoding="utf-8")
    return sorted(text[text.index(head) :].partition("\n\n")[0].splitlines()[2:])
