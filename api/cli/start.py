"""Start of the command line: Ctrl-C ends it with a message, even while modules are imported."""

import json
import signal
import sys
from typing import NoReturn


def main() -> None:
    """Import the command line and run it."""
    try:
        from api.cli.main import main as run  # noqa: PLC0415 - the import may be interrupted
    except KeyboardInterrupt:
        end_interrupted()
    run()


def end_interrupted() -> NoReturn:
    """Exit after an interruption before the work began."""
    sentence = "Interrupted by SIGINT. Nothing was done."
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps({"problems": [{"code": "interrupted", "message": sentence}]}) + "\n")
    else:
        sys.stderr.write(f"error {sentence}\n")
    sys.exit(128 + signal.SIGINT)


if __name__ == "__main__":
    main()
