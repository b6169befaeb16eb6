"""Outages: parts of the service that do not respond. Work waits until they end.

A firewall that forgets a connection drops its packets silently. Without ``SOCKET_OPTIONS`` the kernel sends them again
for a quarter of an hour, and an idle connection looks whole for ever.
"""

import contextlib
import errno
import socket
from collections.abc import Iterator, Mapping
from enum import StrEnum

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from worker.store.errors import ArtifactsUnavailable
from worker.store.files.disk import is_disk_full

IDLE_S, INTERVAL_S, NUM_PROBES = 5, 3, 3
"""Idle time before the first probe, time between probes, number of probes without an answer."""
UNACKNOWLEDGED_S = 15
"""Time that sent data may stay unacknowledged."""

SOCKET_OPTIONS: Mapping[int, int] = {
    getattr(socket, name): value
    for name, value in (
        ("TCP_KEEPIDLE", IDLE_S),
        ("TCP_KEEPINTVL", INTERVAL_S),
        ("TCP_KEEPCNT", NUM_PROBES),
        ("TCP_USER_TIMEOUT", 1000 * UNACKNOWLEDGED_S),  # not on every system
    )
    if hasattr(socket, name)
}
"""Options of a TCP socket by their numbers."""


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


def find_outage(error: BaseException) -> Outage | None:
    """Outage that an error reports; ``None`` if the part responded, for example by refusing a key."""
    if isinstance(error, ArtifactsUnavailable) or (isinstance(error, OSError) and error.errno in _FOLDER_AWAY):
        return Outage.ARTIFACTS
    if isinstance(error, PoolTimeoutError) or (isinstance(error, DBAPIError) and _is_database_away(error)):
        return Outage.DATABASE
    return None


@contextlib.contextmanager
def undo_on_failure() -> Iterator[contextlib.ExitStack]:
    """Call what is put on the stack if the block fails, unless its transaction may have been committed.

    It may have been if the database's answer was lost. Files that it names are kept then; files without a row are
    removed later.
    """
    with contextlib.ExitStack() as undo:
        try:
            yield undo
        except BaseException as error:
            if find_outage(error) is Outage.DATABASE:
                undo.pop_all()
            raise
        undo.pop_all()


def _is_database_away(error: DBAPIError) -> bool:
    if is_disk_full(error):
        return False
    if error.connection_invalidated or getattr(error.orig, "sqlstate", None) == _READ_ONLY:
        return True
    if (code := getattr(error.orig, "sqlite_errorcode", None)) is not None:
        return isinstance(error, OperationalError) and code & _PRIMARY_CODE != _SQLITE_ERROR
    return isinstance(error, OperationalError | InterfaceError)
