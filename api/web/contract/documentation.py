"""Pages of the documentation that are made from the code."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def write_or_check(page: Path, text: str, module: str, words: Sequence[str] | None) -> int:
    """Write a page, or compare it with the code if the command line has ``--check``.

    Parameters
    ----------
    page
        File of the page, in the folder ``docs``.
    text
        Text that the page must have.
    module
        Module that is run to write the page.
    words
        Arguments of the command line; ``None`` for those of this process.

    Returns
    -------
        Exit code: 1 if the page was compared and differs.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=f"Write docs/{page.name} from the code.")
    parser.add_argument("--check", action="store_true", help="Compare with the file; exit with 1 if it differs.")
    if not parser.parse_args(words).check:
        page.write_text(text, encoding="utf-8")
        return 0
    if page.is_file() and page.read_text(encoding="utf-8") == text:
        return 0
    sys.stderr.write(f"docs/{page.name} differs from the code. Run: python -m {module}\n")
    return 1
