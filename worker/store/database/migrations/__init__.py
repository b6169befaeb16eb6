"""The schema's history, by alembic; applied by ``JobStore.migrate``."""
