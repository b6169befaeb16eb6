"""Bodies of requests: forms, JSON, limits, validation, idempotency, and the check of a session's files."""
