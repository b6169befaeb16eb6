"""Job store of a service, opened by commands that work beside it."""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from api.cli.console import refusal
from api.web.settings import Settings
from api.web.startup import unusable_database
from worker.store.errors import UnknownSchema
from worker.store.files.disk import DiskSpace, keep_files_private, make_private
from worker.store.store import JobStore


@contextlib.contextmanager
def opened_store(settings: Settings) -> Iterator[JobStore]:
    """Open the store with the current schema during the block; exit with a message if it can't be opened."""
    keep_files_private()
    try:
        make_private(settings.data_dir)
        store = JobStore(settings.resolved_database_url)
        DiskSpace(settings.data_dir).using_reserve(store.migrate)  # opening a database writes, too
    except (SQLAlchemyError, ImportError, OSError) as error:  # ImportError: no driver for the URL's database
        raise refusal(unusable_database(settings, error)) from error
    except UnknownSchema as error:
        raise refusal(str(error)) from error
    try:
        yield store
    except SQLAlchemyError as error:
        raise refusal(unusable_database(settings, error)) from error
    finally:
        store.close()


def settings_in(data: Path | None) -> Settings:
    """Settings of the service in a data folder; ``None`` for the default folder."""
    return Settings() if data is None else Settings(data_dir=data)


def store_in(data: Path | None) -> AbstractContextManager[JobStore]:
    """Open the store of the service in a data folder; ``None`` for the default folder."""
    return opened_store(settings_in(data))
