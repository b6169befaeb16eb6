"""Answer of a program that checks a stranger's files for a caller who does not open them."""

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from pipeline.core.errors import DISK_FULL, InputError, Problem, listed

EXIT_BAD_INPUT = 2
EXIT_DISK_FULL = 4


def print_answer(check: Callable[[], Mapping[str, Any]], too_large: Problem) -> int:
    """Print what a check answers as one JSON object, or ``{"problems": [...]}``; return the program's exit code.

    ``too_large`` is the problem of files that need more memory than the caller allows.
    """
    try:
        answer = check()
    except InputError as error:
        answer = {"problems": [asdict(problem) for problem in listed(error.problems)]}
    except MemoryError:
        answer = {"problems": [asdict(too_large)]}
    except OSError as error:
        if error.errno not in DISK_FULL:
            raise
        return EXIT_DISK_FULL
    sys.stdout.write(json.dumps(answer, allow_nan=False) + "\n")
    return EXIT_BAD_INPUT if "problems" in answer else 0
