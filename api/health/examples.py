"""Examples of the service's health."""

from typing import Any

ANSWERS: dict[str, Any] = {
    "Health": {"status": "ok"},
    "Readiness": {
        "status": "ready",
        "checks": dict.fromkeys(("database", "broker", "artifacts", "worker", "model", "disk"), True),
        "disk_free_bytes": 214748364800,
    },
}
