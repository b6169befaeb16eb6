"""``python -m api.web.contract.openapi``: write ``openapi/openapi.json``, or compare it with the code (``--check``)."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from api.web.app import create_app
from api.web.contract.documentation import write_or_check
from api.web.settings import Settings

COMMITTED = Path(__file__).parents[3] / "openapi" / "openapi.json"


def document() -> str:
    """Write the contract as JSON."""
    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


def main(words: Sequence[str] | None = None) -> int:
    """Write or compare the contract, and return the exit code."""
    return write_or_check(COMMITTED, document(), "api.web.contract.openapi", words)


if __name__ == "__main__":
    sys.exit(main())
