"""Jobs: reconstruct a session, follow it, cancel, retry, delete."""
