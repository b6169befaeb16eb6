"""Entry point of `multicap`: loading the libraries takes seconds, and Ctrl-C is no stack trace then, either."""

import json
import signal
import sys


def main() -> None:
    """Load the command line and run it."""
    try:
        from api.cli import main as run  # noqa: PLC0415 - what takes long
    except KeyboardInterrupt:
        sentence = "Interrupted by SIGINT. Nothing was done."
        if "--json" in sys.argv:
            sys.stdout.write(json.dumps({"problems": [{"code": "interrupted", "message": sentence}]}) + "\n")
        else:
            sys.stderr.write(f"error {sentence}\n")
        sys.exit(128 + signal.SIGINT)
    run()


if __name__ == "__main__":
    main()
