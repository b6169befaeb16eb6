"""Upgrade of a database's schema to the newest revision."""

import threading

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection

# Alembic keeps its context in globals of the process: two threads can't migrate two databases at once.
_ONE_MIGRATION = threading.Lock()


def upgrade(connection: Connection) -> None:
    """Bring the schema up to date, within the transaction of the connection."""
    config = Config()
    config.set_main_option("script_location", "worker.store.database:migrations")
    config.attributes["connection"] = connection
    with _ONE_MIGRATION:
        command.upgrade(config, "head")
