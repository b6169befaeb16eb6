"""The service's job store, for commands that stand beside it."""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from api.console import refusal
from api.settings import Settings
from worker.jobs.store import JobStore


@contextlib.contextmanager
def opened_store(settings: Settings) -> Iterator[JobStore]:
    """The store, its schema up to date, for the time of the block; without it the command ends with a sentence."""
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        store = JobStore(settings.resolved_database_url)
        store.migrate()
    except (SQLAlchemyError, ImportError, OSError) as error:  # of another database there is no driver
        where = "MULTICAP_DATABASE_URL" if settings.database_url else f"the folder {settings.data_dir}"
        raise refusal(f"The database can't be used. See that it runs and that {where} is right.") from error
    try:
        yield store
    finally:
        store.close()


def store_in(data: Path | None) -> AbstractContextManager[JobStore]:
    """The store of the service in a folder; ``None``: in the usual one."""
    return opened_store(Settings() if data is None else Settings(data_dir=data))
