"""``python -m api.openapi``: write ``openapi/openapi.json``, or with ``--check`` compare it with the code."""

import argparse
import json
import sys
from pathlib import Path

from api.app import create_app
from api.settings import Settings

COMMITTED = Path(__file__).parents[1] / "openapi" / "openapi.json"


def document() -> str:
    """The contract as the file holds it."""
    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


def main() -> int:
    """Write or compare, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m api.openapi", description="The API's contract as a file.")
    parser.add_argument("--check", action="store_true", help="Compare with the file; 1 if they differ.")
    if not parser.parse_args().check:
        COMMITTED.parent.mkdir(exist_ok=True)
        COMMITTED.write_text(document(), encoding="utf-8")
        return 0
    if COMMITTED.is_file() and COMMITTED.read_text(encoding="utf-8") == document():
        return 0
    sys.stderr.write("openapi/openapi.json is not what the code says. Run: python -m api.openapi\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
