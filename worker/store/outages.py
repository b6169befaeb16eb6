"""Outages: parts of the service that do not respond. They are nobody's fault, so the work waits until they end."""

import errno
from enum import StrEnum

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from worker.store.errors import ArtifactsUnavailable
from worker.store.files.disk import is_disk_full

# Errors of a folder on another machine that does not respond.
_FOLDER_AWAY = frozenset({errno.ESTALE, errno.ETIMEDOUT, errno.EHOSTDOWN, errno.EHOSTUNREACH, errno.ENOTCONN})
# Primary code of SQLite for statements that can't be run, such as one that names an unknown table.
_SQLITE_ERROR = 1
_PRIMARY_CODE = 0xFF
# PostgreSQL's code of a server that was replaced by another, and reads only.
_READ_ONLY = "25006"


class Outage(StrEnum):
    """Part of the service that does not respond, as a problem code."""

    DATABASE = "database_unavailable"
    ARTIFACTS = "artifacts_unavailable"
    BROKER = "broker_unavailable"


def outage_of(error: BaseException) -> Outage | None:
    """Outage that an error reports; ``None`` if the part responded, for example by refusing a key."""
    if isinstance(error, ArtifactsUnavailable) or (isinstance(error, OSError) and error.errno in _FOLDER_AWAY):
        return Outage.ARTIFACTS
    if isinstance(error, PoolTimeoutError) or (isinstance(error, DBAPIError) and _is_database_away(error)):
        return Outage.DATABASE
    return None


def is_perhaps_recorded(error: BaseException) -> bool:
    """Whether a transaction that ended with an error may have been committed: the answer of the database was lost.

    Files that the transaction names are kept then; files without a row are removed later.
    """
    return outage_of(error) is Outage.DATABASE


def _is_database_away(error: DBAPIError) -> bool:
    if is_disk_full(error):
        return False
    if error.connection_invalidated or getattr(error.orig, "sqlstate", None) == _READ_ONLY:
        return True
    if (code := getattr(error.orig, "sqlite_errorcode", None)) is not None:
        return isinstance(error, OperationalError) and code & _PRIMARY_CODE != _SQLITE_ERROR
    return isinstance(error, OperationalError | InterfaceError)
