"""End of the command line after Ctrl-C before the work began. Standard library only: it may come while modules load."""

import json
import signal
import sys
from typing import NoReturn

from pipeline.core.problems.finding_codes import INTERRUPTED


def end_interrupted() -> NoReturn:
    """Exit after an interruption before the work began."""
    sentence = "Interrupted by SIGINT. Nothing was done."
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps({"problems": [{"code": INTERRUPTED, "message": sentence}]}) + "\n")
    else:
        sys.stderr.write(f"error {sentence}\n")
    sys.exit(128 + signal.SIGINT)
