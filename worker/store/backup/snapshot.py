"""Database of a backup: one SQLite file, also if the service uses PostgreSQL."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import (
    BigInteger,
    Connection,
    Double,
    Integer,
    Table,
    bindparam,
    func,
    insert,
    inspect,
    select,
    text,
    type_coerce,
)

from worker.store.backup.archive import BackupError, BackupUsageError
from worker.store.database import connection as connections
from worker.store.database.tables import UtcTimestamp, metadata
from worker.store.errors import DamagedDatabase

_ROWS_AT_ONCE = 50
_BUSY_S = 30.0


def take_snapshot(database_url: str, target: Path) -> str:
    """Copy a database in use, as it is at one moment, into a new SQLite file; returns the revision of its schema.

    Raises ``BackupUsageError`` if the database has no tables of Multicap, ``UnknownSchema`` or ``DamagedDatabase``.
    """
    new_private_file(target)
    source = connections.sqlite_path(database_url)
    if source is None:
        _copy_server(database_url, target)
    else:
        connections.require_content(source)
        # In one step: writes of others between steps would make the copy begin again.
        with contextlib.closing(_connect(source)) as database, contextlib.closing(_connect(target)) as copy:
            database.backup(copy)
    with contextlib.closing(_connect(target)) as copy:
        _make_self_contained(copy)
        try:
            (revision,) = copy.execute("SELECT version_num FROM alembic_version").fetchone()
        except (sqlite3.OperationalError, TypeError) as error:
            raise BackupUsageError(f"{source} has no tables of Multicap: its service never started.") from error
    connections.require_known_schema(revision)
    return str(revision)


@contextlib.contextmanager
def damage_blames_source(database_url: str) -> Iterator[None]:
    """Raise ``DamagedDatabase`` for a SQLite database if it, or a copy of it, is found damaged inside the block."""
    try:
        yield
    except (sqlite3.Error, DamagedDatabase) as error:
        source = connections.sqlite_path(database_url)
        reason = error.reason if isinstance(error, DamagedDatabase) else connections.damage_message(error)
        if source is None or reason is None:
            raise
        raise DamagedDatabase(source, reason) from error


def _connect(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"file:{quote(str(path))}?mode=rw", uri=True, timeout=_BUSY_S)


def _make_self_contained(database: sqlite3.Connection) -> None:
    """Keep a database in one file, without a log beside it."""
    database.execute("PRAGMA journal_mode = DELETE")


@contextlib.contextmanager
def opened(database_url: str) -> Iterator[connections.Database]:
    """Database that is closed at the end of the block."""
    database = connections.Database(database_url)
    try:
        yield database
    finally:
        database.close()


def new_private_file(path: Path) -> None:
    """Make an empty file in place of another one, readable by this user only: databases hold secrets."""
    remove_database(path)
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))


@contextlib.contextmanager
def reading(path: Path) -> Iterator[Connection]:
    """Transaction that reads a database file of the newest schema."""
    with opened(f"sqlite:///{path}") as database, database.reading() as connection:
        yield connection


def remove_database(path: Path) -> None:
    """Remove a SQLite file with its journal files."""
    for suffix in ("", "-journal", "-wal", "-shm"):
        path.with_name(f"{path.name}{suffix}").unlink(missing_ok=True)


def prepare(path: Path) -> None:
    """Check the database of a backup and bring its schema up to date.

    Raises ``DamagedDatabase``, ``UnknownSchema``, or ``BackupError`` if a row refers to a missing one, or the database
    has triggers or views.
    """
    with contextlib.closing(_connect(path)) as database:
        database.execute("PRAGMA trusted_schema = OFF")
        (answer,) = database.execute("PRAGMA integrity_check(1)").fetchone()
        if answer != "ok":
            raise DamagedDatabase(path, " ".join(str(answer).split()))
        if database.execute("PRAGMA foreign_key_check").fetchone() is not None:
            raise BackupError("The database is damaged: a row refers to another one that is missing.")
        # A trigger would act with the rights of the service; Multicap makes none.
        foreign = database.execute("SELECT name FROM sqlite_master WHERE type IN ('trigger', 'view')").fetchone()
        if foreign is not None:
            raise BackupError(f"The database has a trigger or view {foreign[0]!r}, which is not Multicap's.")
    with opened(f"sqlite:///{path}") as database:
        database.migrate()
    with contextlib.closing(_connect(path)) as connection:
        _make_self_contained(connection)


def _copy_server(database_url: str, target: Path) -> None:
    with opened(database_url) as server, opened(f"sqlite:///{target}") as copy:
        revision, newest = server.revision(), connections.schema_revisions()[-1]
        if revision is None:
            raise BackupUsageError(
                "The database at MULTICAP_DATABASE_URL has no tables of Multicap: its service never started."
            )
        connections.require_known_schema(revision)
        if revision != newest:
            raise BackupUsageError(
                f"The database has schema {revision}, this version has {newest}. "
                "Make the backup with the version that ran the service, or start this one first."
            )
        copy.migrate()
        with server.snapshot() as rows, copy.writing() as connection:
            copy_rows(rows, connection)


def load(path: Path, database_url: str) -> None:
    """Copy a database file of the newest schema into the empty database of a server, in one transaction."""
    with opened(f"sqlite:///{path}") as copy, opened(database_url) as server:
        require_empty(server)
        server.migrate()
        with copy.reading() as rows, server.writing() as connection:
            copy_rows(rows, connection)


def require_empty(server: connections.Database) -> None:
    """Raise ``BackupUsageError`` if a database has rows of Multicap."""
    with server.reading() as connection:
        there = set(inspect(connection).get_table_names())
        for table in metadata.sorted_tables:
            if table.name in there and connection.execute(select(text("1")).select_from(table).limit(1)).first():
                raise BackupUsageError("The database at MULTICAP_DATABASE_URL is not empty. Restore into an empty one.")


def copy_rows(source: Connection, target: Connection) -> None:
    """Copy all rows, and the last ids that were used, between databases of the newest schema."""
    for table in metadata.sorted_tables:
        # Times are copied as numbers.
        columns = [
            type_coerce(column, Double) if isinstance(column.type, UtcTimestamp) else column for column in table.columns
        ]
        query = select(*(column.label(stored.name) for column, stored in zip(columns, table.columns, strict=True)))
        found = source.execute(query, execution_options={"yield_per": _ROWS_AT_ONCE})
        for rows in found.mappings().partitions():
            target.execute(insert(table), [dict(row) for row in rows])
    for table in _numbered():
        if (last := _last_number(source, table)) > 0:
            values = {"name": table.name, "last": last}
            if target.dialect.name == "sqlite":
                target.execute(text("DELETE FROM sqlite_sequence WHERE name = :name"), {"name": table.name})
                target.execute(text("INSERT INTO sqlite_sequence (name, seq) VALUES (:name, :last)"), values)
            else:
                statement = text("SELECT setval(CAST(pg_get_serial_sequence(:name, 'id') AS regclass), :last)")
                target.execute(statement.bindparams(bindparam("last", type_=BigInteger)), values)


def _numbered() -> list[Table]:
    """Tables whose ids are numbers of the database; an id is never used again."""
    return [
        table
        for table in metadata.sorted_tables
        if len(table.primary_key) == 1 and isinstance(next(iter(table.primary_key)).type, BigInteger | Integer)
    ]


def _last_number(connection: Connection, table: Table) -> int:
    if connection.dialect.name == "sqlite":
        query = text("SELECT seq FROM sqlite_sequence WHERE name = :name")
    else:
        query = text("SELECT pg_sequence_last_value(CAST(pg_get_serial_sequence(:name, 'id') AS regclass))")
    given = connection.scalar(query, {"name": table.name}) or 0
    return max(given, connection.scalar(select(func.max(table.c.id))) or 0)
