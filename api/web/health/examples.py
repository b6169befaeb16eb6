"""Examples of the service's health."""

from typing import Any

ANSWERS: dict[str, Any] = {
    "Health": {"status": "ok", "version": "1.0.0"},
    "Readiness": {
        "status": "ready",
        "checks": dict.fromkeys(("database", "broker", "artifacts", "worker", "model", "disk"), True),
        "providers": [{"name": "cuda", "device": "NVIDIA GeForce RTX 4090", "note": "", "workers": 4}],
        "disk_free_bytes": 214748364800,
    },
}
