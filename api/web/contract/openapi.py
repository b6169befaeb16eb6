"""``python -m api.web.contract.openapi``: write ``openapi/openapi.json`` from the code."""

import json
from pathlib import Path

from api.web.app import create_app
from api.web.settings import Settings

COMMITTED = Path(__file__).parents[3] / "openapi" / "openapi.json"


def document() -> str:
    """Write the contract as JSON."""
    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    COMMITTED.write_text(document(), encoding="utf-8")
