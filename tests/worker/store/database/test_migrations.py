"""Upgrades of databases from the first release on: rows stay, and the schema becomes that of the tables."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory

from tests.worker.store.conftest import LEASE_S, StoreBench, schema_differences
from worker.store.database.connection import schema_revisions
from worker.store.errors import UnknownSchema
from worker.store.model.states import JobState
from worker.store.store import JobStore

CONFIG = Config()
CONFIG.set_main_option("script_location", "worker.store.database:migrations")
REVISIONS = [script.revision for script in ScriptDirectory.from_config(CONFIG).walk_revisions()]
# Rows of all tables of the first release: a finished job, one that failed and was retried, one that runs, and a row of
# everything else. A later migration changes this file in no way.
FIRST_ROWS: dict[str, list[dict[str, Any]]] = json.loads(
    Path(__file__).with_name("first_release_rows.json").read_text()
)


@pytest.fixture
def engine(empty_database_url: str) -> Iterator[sa.Engine]:
    engine = sa.create_engine(empty_database_url)
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA foreign_keys = ON"))
    yield engine
    engine.dispose()


@pytest.fixture
def first_release(engine: sa.Engine, empty_database_url: str) -> Iterator[JobStore]:
    """A store whose database is as the first release left it."""
    with engine.begin() as connection:
        CONFIG.attributes["connection"] = connection
        command.upgrade(CONFIG, REVISIONS[-1])
    with engine.begin() as connection:
        for table in reflect(connection).sorted_tables:
            rows = FIRST_ROWS.get(table.name, [])
            for row in rows:
                values = {name: value for name, value in row.items() if value is not None}  # no JSON null
                connection.execute(sa.insert(table).values(values))
            if engine.dialect.name == "postgresql" and rows and isinstance(rows[0].get("id"), int):
                sequence = sa.func.pg_get_serial_sequence(table.name, "id")
                connection.execute(sa.select(sa.func.setval(sequence, max(row["id"] for row in rows))))
    store = JobStore(empty_database_url)
    yield store
    store.close()


def reflect(connection: sa.Connection) -> sa.MetaData:
    metadata = sa.MetaData()
    metadata.reflect(connection)
    return metadata


def stored_rows(engine: sa.Engine) -> dict[str, list[dict[str, Any]]]:
    """All rows by table, in the order of their keys."""
    with engine.connect() as connection:
        return {
            table.name: [
                dict(row) for row in connection.execute(sa.select(table).order_by(*table.primary_key)).mappings()
            ]
            for table in reflect(connection).sorted_tables
            if table.name != "alembic_version"
        }


def test_revisions_in_file_names_are_those_of_alembic() -> None:
    assert schema_revisions() == tuple(reversed(REVISIONS))


def test_first_schema_follows_tables_only_while_it_is_the_only_one() -> None:
    first = ScriptDirectory.from_config(CONFIG).get_revision(REVISIONS[-1])
    assert first is not None
    assert len(REVISIONS) == 1 or "create_all" not in Path(first.path).read_text(encoding="utf-8")


def test_first_release_has_row_in_every_table(first_release: JobStore, engine: sa.Engine) -> None:
    assert [table for table, rows in stored_rows(engine).items() if not rows] == []


def test_upgrade_from_first_release_keeps_rows(first_release: JobStore, engine: sa.Engine) -> None:
    first_release.migrate()
    with engine.connect() as connection:
        assert schema_differences(connection) == []
    after = stored_rows(engine)
    for table, rows in FIRST_ROWS.items():
        for before, row in zip(rows, after[table], strict=True):
            shared = before.keys() & row.keys()
            assert {name: row[name] for name in shared} == {name: before[name] for name in shared}


def test_upgraded_database_is_read_and_its_work_continues(first_release: JobStore, empty_database_url: str) -> None:
    first_release.migrate()
    states = sorted(job.state for job in first_release.jobs.page())
    assert states == [JobState.QUEUED, JobState.RUNNING, JobState.SUCCEEDED]
    (capture,) = first_release.sessions.page()
    first_release.leases.reap(LEASE_S)
    StoreBench(empty_database_url, first_release, capture.session.id).finish_all()
    assert {job.state for job in first_release.jobs.page()} == {JobState.SUCCEEDED}
    assert [result.name for job in first_release.jobs.page() for result in first_release.results.downloads(job.id)]
    assert first_release.tenant("default").usage().stored_bytes > 3_000_000_000


@pytest.mark.parametrize(
    ("revision", "message"),
    [("0099", r"newer version of Multicap \(schema 0099\)"), ("0040", r"before its first release \(schema 0040\)")],
)
def test_unknown_revision_is_refused_and_left_alone(jobs: StoreBench, revision: str, message: str) -> None:
    jobs.execute(sa.text("UPDATE alembic_version SET version_num = :revision").bindparams(revision=revision))
    with pytest.raises(UnknownSchema, match=message):
        jobs.store.migrate()
    with pytest.raises(UnknownSchema, match=message):
        jobs.store.require_known_schema()
    restored = sa.text("UPDATE alembic_version SET version_num = :now WHERE version_num = :revision")
    jobs.execute(restored.bindparams(now=REVISIONS[0], revision=revision))
    jobs.store.migrate()
