"""Links that open something of a job without a key."""
