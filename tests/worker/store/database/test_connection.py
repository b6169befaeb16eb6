import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from tests.worker.store.conftest import StoreBench, schema_differences
from worker.store.database.connection import Database, now, upsert
from worker.store.database.tables import artifacts
from worker.store.database.tables import jobs as jobs_table
from worker.store.database.transitions import lock_job
from worker.store.outages import Outage, find_outage
from worker.store.store import JobStore


def test_migrations_lead_to_tables(jobs: StoreBench) -> None:
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        assert schema_differences(connection) == []
    engine.dispose()


def test_migrating_again_keeps_what_is_there(jobs: StoreBench) -> None:
    job = jobs.queue()
    jobs.store.migrate()
    assert jobs.store.jobs.get(job.id) == job


def test_several_may_migrate_at_once(empty_database_url: str) -> None:
    stores = [JobStore(empty_database_url) for _ in range(6)]
    with ThreadPoolExecutor(len(stores)) as pool:
        list(pool.map(JobStore.migrate, stores))
    assert all(store.ping() for store in stores)
    for store in stores:
        store.close()


def test_ping_wants_schema(empty_database_url: str) -> None:
    store = JobStore(empty_database_url)
    assert not store.ping()
    store.migrate()
    assert store.ping()
    store.close()


def test_ping_of_database_that_is_away(tmp_path: Path) -> None:
    assert not JobStore(f"sqlite:///{tmp_path / 'missing' / 'jobs.db'}").ping()


def test_clock_counts_seconds_in_utc(database_url: str) -> None:
    database = Database(database_url)
    with database.reading() as connection:
        started = time.monotonic()
        first = connection.scalar(sa.select(now()))
        time.sleep(0.05)
        second = connection.scalar(sa.select(now()))
        elapsed = time.monotonic() - started
    database.close()
    assert first == pytest.approx(datetime.now(UTC).timestamp(), abs=5)
    assert 0.04 < second - first < elapsed + 0.01


def test_times_are_read_in_utc(jobs: StoreBench) -> None:
    created_at = jobs.queue().created_at
    assert created_at.tzinfo is UTC
    assert abs(datetime.now(UTC) - created_at) < timedelta(seconds=5)


def test_sqlite_is_set_up(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'jobs.db'}")
    with database.reading() as connection:
        pragmas = {
            name: connection.scalar(sa.text(f"PRAGMA {name}"))
            for name in ("journal_mode", "foreign_keys", "busy_timeout")
        }
    database.close()
    assert pragmas == {"journal_mode": "wal", "foreign_keys": 1, "busy_timeout": 30_000}


def test_transaction_with_error_is_undone(jobs: StoreBench) -> None:
    database = Database(jobs.url)
    row = {"session_id": jobs.session_id, "output_key": "k", "sha256": "0", "num_bytes": 1}

    def write_and_fail() -> None:
        with database.writing() as connection:
            upsert(connection, artifacts, row)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_and_fail()
    assert jobs.store.outputs.find(jobs.session_id, "k") is None
    with database.writing() as connection:
        upsert(connection, artifacts, row)
        upsert(connection, artifacts, {**row, "sha256": "1"})
    database.close()
    assert jobs.store.outputs.find(jobs.session_id, "k") == ("1", 1)


def test_readers_see_state_while_another_writes(jobs: StoreBench) -> None:
    database = Database(jobs.url)
    with database.writing() as connection:
        upsert(connection, artifacts, {"session_id": jobs.session_id, "output_key": "k", "sha256": "0", "num_bytes": 1})
        assert jobs.store.outputs.find(jobs.session_id, "k") is None
        assert jobs.store.sessions.get(jobs.session_id).name == "take"
    database.close()
    assert jobs.store.outputs.find(jobs.session_id, "k") == ("0", 1)


@pytest.mark.parametrize("backend", ["postgresql"])
def test_lock_of_frozen_process_ends(jobs: StoreBench, backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.store.database.connection._IDLE_TRANSACTION_S", 0.5)
    job_id = jobs.queue().id
    frozen, working = Database(jobs.url), Database(jobs.url)
    with pytest.raises(sa.exc.DBAPIError) as caught, frozen.writing() as held:  # noqa: PT012 - it begins a transaction
        assert lock_job(held, job_id) is not None
        with working.writing() as connection:  # waits for the lock
            assert lock_job(connection, job_id) is not None
        lock_job(held, job_id)
    assert find_outage(caught.value) is Outage.DATABASE
    with frozen.writing() as connection:
        assert lock_job(connection, job_id) is not None
    with frozen.snapshot() as connection:
        time.sleep(1.0)  # a backup may take long
        assert connection.scalar(sa.select(jobs_table.c.id)) == job_id
    for database in (frozen, working):
        database.close()
