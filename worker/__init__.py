"""Durable jobs in a database, and the processes that run them: workers, reaper, supervisor."""
