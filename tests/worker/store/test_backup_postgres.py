"""Backups of a service on PostgreSQL, and from one database to the other."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from tests.worker.store.backups import Data, busy_writers, opened_data, restored
from tests.worker.store.conftest import postgres_database
from worker.store.backup.archive import BackupError, BackupUsageError
from worker.store.backup.create import create_backup
from worker.store.backup.restore import verify_backup
from worker.store.database.tables import metadata
from worker.store.model.rights import Scope
from worker.store.model.states import JobState


@pytest.fixture
def postgres_url_empty(postgres: sa.Engine) -> Iterator[str]:
    with postgres_database(postgres) as url:
        yield url


@pytest.fixture
def second_postgres_url(postgres: sa.Engine) -> Iterator[str]:
    with postgres_database(postgres) as url:
        yield url


def fill(data: Data) -> None:
    done, other = data.add_session(), data.add_session(name="Übung \N{MAN}")
    data.add_job(done)
    data.run_all()
    data.add_job(other)
    data.run_chunk()
    forgotten = data.add_job(other)
    data.store.jobs.cancel(forgotten.id)
    data.store.jobs.delete(forgotten.id)  # its chunks had the highest numbers
    _, secret = data.store.keys.add("studio", "portal", {Scope.READ})
    data.store.webhook_secrets.rotate("studio", 60.0)
    assert secret


def all_rows(url: str) -> dict[str, list[tuple[object, ...]]]:
    """All rows, times as numbers."""
    engine = sa.create_engine(url)
    try:
        with engine.connect() as connection:
            return {
                table.name: sorted((tuple(row) for row in connection.execute(sa.select(table)).all()), key=repr)
                for table in metadata.sorted_tables
            }
    finally:
        engine.dispose()


def next_chunk_id(data: Data) -> int:
    job = data.add_job(data.store.sessions.page()[0].session.id)
    engine = sa.create_engine(sa.make_url(data.url))
    with engine.connect() as connection:
        found = connection.scalar(sa.text("SELECT min(id) FROM chunks WHERE job_id = :id"), {"id": job.id})
    engine.dispose()
    return int(found or 0)


def test_from_sqlite_to_postgresql_and_back(postgres_url_empty: str, second_postgres_url: str, tmp_path: Path) -> None:
    with opened_data(tmp_path / "first") as first:
        fill(first)
        assert first.back_up(tmp_path / "1.tar").problems == ()
        before, tree = all_rows(first.url), first.tree()
        expected_id = next_chunk_id(first)
    restored(tmp_path / "1.tar", tmp_path / "second", postgres_url_empty)
    assert not (tmp_path / "second" / "multicap.db").exists()
    assert all_rows(postgres_url_empty) == before
    with opened_data(tmp_path / "second", postgres_url_empty) as second:
        assert second.tree() == tree
        report = second.back_up(tmp_path / "2.tar")
        assert report.problems == ()
        assert verify_backup(tmp_path / "2.tar", lambda *_: None).faults == ()
    restored(tmp_path / "2.tar", tmp_path / "third")
    restored(tmp_path / "2.tar", tmp_path / "fourth", second_postgres_url)
    for folder, url in (("third", ""), ("fourth", second_postgres_url)):
        with opened_data(tmp_path / folder, url) as there:
            assert all_rows(there.url) == before
            assert there.tree() == tree
            # No number comes again, not even one whose row was deleted.
            assert next_chunk_id(there) == expected_id
            there.run_all()
            assert {job.state for job in there.store.jobs.page()} == {JobState.SUCCEEDED}


def test_database_that_is_not_empty_is_refused_and_stays(postgres_url_empty: str, tmp_path: Path) -> None:
    with opened_data(tmp_path / "first") as first:
        fill(first)
        first.back_up(tmp_path / "1.tar")
    with opened_data(tmp_path / "other", postgres_url_empty) as other:
        other.add_session()
        before = all_rows(postgres_url_empty)
    with pytest.raises(BackupUsageError, match="not empty"):
        restored(tmp_path / "1.tar", tmp_path / "second", postgres_url_empty)
    assert all_rows(postgres_url_empty) == before
    assert not (tmp_path / "second").exists()


def test_restore_that_fails_leaves_no_rows(postgres_url_empty: str, tmp_path: Path) -> None:
    with opened_data(tmp_path / "first") as first:
        fill(first)
        long = first.add_session(name="x\0y")  # SQLite keeps it, PostgreSQL does not
        assert long
        first.back_up(tmp_path / "1.tar")
    with pytest.raises(BackupError, match="The database failed"):
        restored(tmp_path / "1.tar", tmp_path / "second", postgres_url_empty)
    assert not any(all_rows(postgres_url_empty).values())
    assert not (tmp_path / "second").exists()


@pytest.mark.slow
def test_backup_is_consistent_while_others_write(postgres_url_empty: str, tmp_path: Path) -> None:
    with (
        opened_data(tmp_path / "data", postgres_url_empty) as data,
        busy_writers(data, num_bytes=50_000),
    ):
        for number in range(4):
            time.sleep(0.3)
            archive = tmp_path / f"{number}.tar"
            assert create_backup(data.folder, data.url, "", archive, lambda *_: None).problems == ()
            assert verify_backup(archive, lambda *_: None).faults == ()
