"""Database of the job store: transactions, clock, schema, and differences between SQLite and PostgreSQL."""

import contextlib
import functools
import json
import os
import sqlite3
import time
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from sqlalchemy import Connection, Double, Engine, Table, create_engine, event, inspect, text
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import ExceptionContext, make_url
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import FunctionElement

from worker.store import outages
from worker.store.errors import DamagedDatabase, UnknownSchema

# Time that a transaction waits for the lock of another one.
_LOCK_TIMEOUT_S = 30.0
_LOCK_RETRY_S = 0.01
_CONNECT_TIMEOUT_S = 5
# Age of a connection to PostgreSQL, and time that a transaction waits for one, after which a request is refused.
_RECYCLE_S = 600
_POOL_TIMEOUT_S = 10.0
# Time after which PostgreSQL ends a transaction that asks nothing: its process may be frozen, and others wait for its
# locks.
_IDLE_TRANSACTION_S = 30.0
# Options of the client's library. A dead connection is noticed in seconds; parameters of the URL replace them.
_POSTGRES_OPTIONS: Mapping[str, int] = {
    "connect_timeout": _CONNECT_TIMEOUT_S,
    "keepalives": 1,
    "keepalives_idle": outages.IDLE_S,
    "keepalives_interval": outages.INTERVAL_S,
    "keepalives_count": outages.NUM_PROBES,
    "tcp_user_timeout": 1000 * outages.UNACKNOWLEDGED_S,
}

_DAMAGE = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_PRIMARY_CODE = 0xFF
# Message of Python's driver for text of a damaged page; the error has no code.
_NOT_TEXT = "Could not decode to UTF-8"

_REVISION_TABLE = "alembic_version"
_MIGRATION_LOCK = 0x6D63_6170  # any number, the same in every process


class now(FunctionElement[float]):  # noqa: N801 - reads as the SQL function it is
    """Time of the database's clock when the statement runs: seconds since 1970 in UTC."""

    type = Double()
    inherit_cache = True


@compiles(now, "sqlite")
def _now_sqlite(element: now, compiler: SQLCompiler, **kwargs: Any) -> str:
    return "((julianday('now') - 2440587.5) * 86400.0)"


@compiles(now, "postgresql")
def _now_postgresql(element: now, compiler: SQLCompiler, **kwargs: Any) -> str:
    return "CAST(EXTRACT(EPOCH FROM clock_timestamp()) AS DOUBLE PRECISION)"


def upsert(connection: Connection, table: Table, row: Mapping[str, Any]) -> None:
    """Insert a row, or replace the one with its primary key."""
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    keys = [column.name for column in table.primary_key]
    values = {name: value for name, value in row.items() if name not in keys}
    connection.execute(dialect.insert(table).values(**row).on_conflict_do_update(index_elements=keys, set_=values))


def add_up(connection: Connection, table: Table, key: Mapping[str, Any], column: str, amount: float) -> None:
    """Add an amount to a column of the row with a primary key; insert the row if it is missing."""
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    row = dialect.insert(table).values(**key, **{column: amount})
    sum_of_both = {column: table.c[column] + row.excluded[column]}
    connection.execute(row.on_conflict_do_update(index_elements=list(key), set_=sum_of_both))


def lock(connection: Connection, name: str) -> None:
    """Lock a name until the end of the transaction, which writes; other transactions wait for the name."""
    # SQLite has one writer at a time.
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(hashtextextended(:name, 0))"), {"name": name})


@functools.cache
def schema_revisions() -> tuple[str, ...]:
    """Revisions of the schema, the first one first; the names of their modules begin with them."""
    modules = Path(__file__).with_name("migrations").joinpath("versions").glob("v????_*.py")
    return tuple(sorted(module.stem[1:5] for module in modules))


def require_known_schema(revision: str) -> None:
    """Raise ``UnknownSchema`` for a revision of the schema that this version does not know."""
    if revision not in (known := schema_revisions()):
        raise UnknownSchema(revision, is_newer=revision > known[-1])


def sqlite_path(database_url: str) -> Path | None:
    """Path of a SQLite database; ``None`` for another one."""
    url = make_url(database_url)
    return Path(url.database or "") if url.get_backend_name() == "sqlite" else None


def damage_message(error: BaseException) -> str | None:
    """Message of SQLite if an error says that its file is damaged; ``None`` for other errors."""
    code = getattr(error, "sqlite_errorcode", 0) & _PRIMARY_CODE
    return str(error) if code in _DAMAGE or str(error).startswith(_NOT_TEXT) else None


def require_content(path: Path) -> None:
    """Raise ``DamagedDatabase`` for an empty file beside files of sessions: SQLite takes it for a new database."""
    if path.is_file() and path.stat().st_size == 0 and any(path.parent.glob("artifacts/sessions/*")):
        raise DamagedDatabase(path, "the file is empty, though there are files of sessions beside it")


def _revision(connection: Connection) -> str | None:
    """Revision of the schema; ``None`` if there is none."""
    if not inspect(connection).has_table(_REVISION_TABLE):
        return None
    found: str | None = connection.execute(text(f"SELECT version_num FROM {_REVISION_TABLE}")).scalar()  # noqa: S608 - our own name
    return found


class Database:
    """One database, SQLite or PostgreSQL; may be shared by threads and carried across a fork.

    Once SQLite has found its file damaged, every transaction raises ``DamagedDatabase``: writing to such a file makes
    the damage worse. ``url`` is SQLAlchemy's. A SQLite file is made if it is missing; its folder is not.
    """

    def __init__(self, url: str) -> None:
        self._url = make_url(url)
        if self._url.drivername in {"postgres", "postgresql"}:  # the driver that is installed
            self._url = self._url.set(drivername="postgresql+psycopg")
        self._damage: str | None = None
        self._engine = self._create_engine()
        self._inherited: list[Engine] = []
        _databases.add(self)

    @property
    def is_damaged(self) -> bool:
        """True if the file was found damaged since this object was made."""
        return self._damage is not None

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """Transaction that reads."""
        self._require_undamaged()
        with self._engine.begin() as connection:
            yield connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[Connection]:
        """Transaction that writes. In SQLite it waits here for its turn, instead of failing at its first write."""
        self._require_undamaged()
        with self._engine.connect().execution_options(writing=True) as connection, connection.begin():
            yield connection

    @contextlib.contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """Transaction that reads all tables as they are at one moment."""
        self._require_undamaged()
        with self._engine.connect() as connection:
            if connection.dialect.name == "postgresql":  # SQLite always reads so
                connection.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                if connection.dialect.name == "postgresql":  # the rows may be worked on for long
                    connection.execute(text("SET LOCAL idle_in_transaction_session_timeout = 0"))
                yield connection

    def revision(self) -> str | None:
        """Revision of the schema; ``None`` if there is none."""
        with self.reading() as connection:
            return _revision(connection)

    def require_known_schema(self) -> None:
        """Raise ``UnknownSchema`` if this version does not know the schema."""
        if (revision := self.revision()) is not None:
            require_known_schema(revision)

    def require_whole(self) -> None:
        """Raise ``DamagedDatabase`` if SQLite finds its file damaged; reads the complete file.

        Damage within a row's values is not found.
        """
        if (path := self._path) is None:
            return
        require_content(path)
        with self.reading() as connection:
            answer = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
        if answer != "ok":
            self._fail(" ".join(str(answer).split()))

    def migrate(self) -> None:
        """Bring the schema up to date; several processes may try at once.

        Raises ``DamagedDatabase``, or ``UnknownSchema`` if this version does not know the schema; the database stays as
        it is.
        """
        self.require_whole()
        with self.writing() as connection:
            if connection.dialect.name == "postgresql":
                connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _MIGRATION_LOCK})
            if (revision := _revision(connection)) == schema_revisions()[-1]:
                return
            if revision is not None:
                require_known_schema(revision)
            # It takes a third of a second to load, and most processes find the schema up to date.
            from worker.store.database.migrations.upgrade import upgrade  # noqa: PLC0415

            upgrade(connection)

    def close(self) -> None:
        """Close the connections that are not in use."""
        self._engine.dispose()

    def _renew_after_fork(self) -> None:
        # The parent's connections stay open here, unused: closing them would end the sessions of the parent and release
        # its locks in SQLite.
        self._inherited.append(self._engine)
        self._engine = self._create_engine()

    @property
    def _path(self) -> Path | None:
        return sqlite_path(self._url.render_as_string(hide_password=False))

    def _create_engine(self) -> Engine:
        if self._url.get_backend_name() != "sqlite":
            options = {name: value for name, value in _POSTGRES_OPTIONS.items() if name not in self._url.query}
            engine = create_engine(
                self._url,
                pool_pre_ping=True,
                pool_recycle=_RECYCLE_S,
                pool_timeout=_POOL_TIMEOUT_S,
                hide_parameters=True,
                connect_args=options,
            )
            event.listen(engine, "connect", _limit_idle_transactions)
            return engine
        # Parameters of statements are hidden in errors, which are logged: some are secrets.
        engine = create_engine(
            self._url,
            connect_args={"timeout": _LOCK_TIMEOUT_S},
            json_deserializer=self._read_json,
            hide_parameters=True,
        )
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
        event.listen(engine, "handle_error", self._note_damage)
        return engine

    def _read_json(self, text: str) -> Any:
        try:
            return json.loads(text)
        except ValueError:
            self._fail("a row holds text that is no JSON")

    def _note_damage(self, context: ExceptionContext) -> None:
        if reason := damage_message(context.original_exception):
            self._fail(reason)

    def _fail(self, reason: str) -> NoReturn:
        self._damage = reason
        raise DamagedDatabase(self._path or Path(), reason)

    def _require_undamaged(self) -> None:
        if self._damage is not None:
            self._fail(self._damage)


_databases: "weakref.WeakSet[Database]" = weakref.WeakSet()


def _renew_all_after_fork() -> None:
    for database in list(_databases):
        database._renew_after_fork()


os.register_at_fork(after_in_child=_renew_all_after_fork)


def _limit_idle_transactions(connection: Any, record: Any) -> None:
    milliseconds = round(1000 * _IDLE_TRANSACTION_S)
    # No option of the connection: poolers such as PgBouncer refuse those that they don't know.
    connection.execute(f"SET idle_in_transaction_session_timeout = {milliseconds}")
    connection.commit()


def _configure_sqlite(connection: sqlite3.Connection, record: Any) -> None:
    # Python's driver begins transactions late and commits some by itself; without an isolation level it does neither.
    connection.isolation_level = None
    _write_ahead(connection)
    connection.execute("PRAGMA foreign_keys = ON")
    connection.execute("PRAGMA secure_delete = ON")  # backups copy pages, and must not have secrets of the past


def _write_ahead(connection: sqlite3.Connection) -> None:
    # The file keeps its journal mode, so only the first connection changes it. If several processes open the first one
    # at the same time, SQLite refuses all but one, whatever the timeout: each holds a shared lock that another needs.
    deadline = time.monotonic() + _LOCK_TIMEOUT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > deadline:
                raise
            time.sleep(_LOCK_RETRY_S)
        else:
            return


def _begin_sqlite(connection: Connection) -> None:
    # A transaction that reads first and writes later can't wait for its turn, so writing is announced at the begin.
    writing = connection.get_execution_options().get("writing", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writing else "BEGIN")
