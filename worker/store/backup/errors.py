"""Errors of backups, as sentences for an operator."""

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from worker.store.errors import DamagedDatabase
from worker.store.files.disk import is_disk_full


class BackupError(Exception):
    """A backup can't be made, read or restored. ``faults`` holds one sentence for each problem."""

    def __init__(self, *faults: str) -> None:
        super().__init__(" ".join(faults))
        self.faults = faults


class BackupUsageError(BackupError):
    """An argument or a setting can't be used; nothing was done."""


@contextlib.contextmanager
def writing_to(place: Path) -> Iterator[None]:
    """Raise ``BackupError`` if a file or a database can't be written inside the block."""
    try:
        yield
    except DamagedDatabase:
        raise
    except OSError as error:
        if is_disk_full(error):
            raise disk_full(Path(error.filename) if error.filename else place) from error
        raise BackupError(f"{error.filename or place} can't be used: {error.strerror or error}.") from error
    except ImportError as error:
        raise BackupUsageError(f"There is no driver for the database at MULTICAP_DATABASE_URL: {error}.") from error
    except (sqlite3.Error, SQLAlchemyError) as error:
        cause = getattr(error, "orig", error)
        if is_disk_full(error):
            raise disk_full(place) from error
        raise BackupError(f"The database failed: {str(cause).strip()}.") from error


def disk_full(place: Path) -> BackupError:
    """Error of a full disk."""
    return BackupError(f"The disk of {place.parent} is full. Make room there, or choose another folder.")
