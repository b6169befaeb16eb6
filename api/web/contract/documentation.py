"""Files that are made from the code: pages of the documentation, and the contract."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def write_or_check(path: Path, text: str, module: str, words: Sequence[str] | None) -> int:
    """Write a file, or compare it with the code if the command line has ``--check``; return the exit code.

    ``module`` is run to write the file. ``words`` are the arguments of the command line, by default of this process.
    """
    name = f"{path.parent.name}/{path.name}"
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=f"Write {name} from the code.")
    parser.add_argument("--check", action="store_true", help="Compare with the file; exit with 1 if it differs.")
    if not parser.parse_args(words).check:
        path.write_text(text, encoding="utf-8")
        return 0
    if path.is_file() and path.read_text(encoding="utf-8") == text:
        return 0
    sys.stderr.write(f"{name} differs from the code. Run: python -m {module}\n")
    return 1
