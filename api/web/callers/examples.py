"""Examples of callers."""

from typing import Any

ANSWERS: dict[str, Any] = {
    "Caller": {
        "tenant": "studio-a",
        "name": "portal",
        "scopes": ["read", "write"],
        "expires_at": None,
        "quotas": {
            "sessions": {"used": 12, "limit": 100},
            "unfinished_jobs": {"used": 1, "limit": 4},
            "stored_bytes": {"used": 52428800000, "limit": None},
            "uploads": {"used": 0, "limit": None},
        },
    },
}
