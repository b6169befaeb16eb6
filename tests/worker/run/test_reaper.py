"""Reaper: it publishes messages for unclaimed work, and survives an unreachable database."""

import os
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa

from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.run.engine.stage import DETECT
from tests.waiting import wait_for
from tests.worker.conftest import RunnerBench
from worker.run.reaper import Reaper
from worker.store.database.connection import Database
from worker.store.database.tables import removals
from worker.store.database.totals import Total
from worker.store.errors import Conflict
from worker.store.files.disk import DiskSpace
from worker.store.files.file_keys import record_key, result_key, stage_key
from worker.store.model.states import JobState
from worker.store.repositories.work.expiry import remove_files
from worker.store.store import JobStore

LEASE_S = 20.0


class Publisher:
    """Counts published messages."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> bool:
        self.count += 1
        return True


def test_messages_are_published_for_ready_work_only(bench: RunnerBench) -> None:
    publish = Publisher()
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), publish, LEASE_S).reap()
    assert publish.count == 0
    bench.create_job()
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), publish, LEASE_S).reap()
    assert publish.count == 1
    bench.runner().work(60.0)
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), publish, LEASE_S).reap()
    assert publish.count == 1


def test_leases_of_silent_workers_are_freed(bench: RunnerBench) -> None:
    job = bench.create_job()
    assert bench.store.leases.claim("gone", 0.05)
    publish = Publisher()
    time.sleep(0.1)
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), publish, LEASE_S).reap()
    assert publish.count == 1
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_several_reapers_free_lease_once(bench: RunnerBench) -> None:
    job = bench.create_job()
    assert bench.store.leases.claim("gone", 0.05)
    time.sleep(0.1)
    reapers = [Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), Publisher(), LEASE_S) for _ in range(3)]
    with ThreadPoolExecutor(len(reapers)) as pool:
        list(pool.map(lambda reaper: [reaper.reap() for _ in range(5)], reapers))
    totals = bench.store.figures().totals
    assert sum(value for (name, _), value in totals.items() if name == Total.LEASES_LOST) == 1
    bench.runner().work(60.0)
    assert bench.store.jobs.get(job.id).state is JobState.SUCCEEDED


def test_reaper_survives_unreachable_database(bench: RunnerBench, capfd: pytest.CaptureFixture[str]) -> None:
    store = JobStore("sqlite:////nonexistent/folder/multicap.db")
    Reaper(store, bench.artifacts, DiskSpace(bench.data_dir), Publisher(), LEASE_S).reap()
    store.close()
    assert "reap_failed" in "".join(capfd.readouterr())


def test_expired_results_are_removed(bench: RunnerBench, capfd: pytest.CaptureFixture[str]) -> None:
    kept, short = bench.create_job(), bench.create_job(retention_s=0.05)
    bench.runner().work(60.0)
    time.sleep(0.1)
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), Publisher(), LEASE_S).reap()
    assert bench.store.jobs.get(short.id).state is JobState.EXPIRED
    assert not bench.artifacts.exists(result_key(short.id, "person-1.bvh"))
    assert bench.store.jobs.get(kept.id).state is JobState.SUCCEEDED
    assert bench.artifacts.exists(result_key(kept.id, "person-1.bvh"))
    assert "job_expired" in "".join(capfd.readouterr())


def test_files_of_interrupted_deletions_are_removed(bench: RunnerBench) -> None:
    job = bench.create_job()
    bench.runner().work(60.0)
    files = [
        result_key(job.id, "person-1.bvh"),
        *(stage_key(bench.session.id, output.key) for output in bench.store.outputs.list_stage(job.id, DETECT)),
    ]
    assert all(bench.artifacts.exists(key) for key in files)
    bench.store.sessions.delete(bench.session.id)
    Reaper(bench.store, bench.artifacts, DiskSpace(bench.data_dir), Publisher(), LEASE_S).reap()
    assert not any(bench.artifacts.exists(key) for key in files)
    assert bench.store.removals.due() == []


def test_failed_removals_are_repeated(
    bench: RunnerBench, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    job, other = bench.create_job(), bench.create_job()
    bench.runner().work(60.0)
    bench.store.jobs.delete(job.id)
    bench.store.jobs.delete(other.id)
    remove = bench.artifacts.delete_prefix

    def refuse(prefix: str) -> None:
        if job.id in prefix:
            raise PermissionError
        remove(prefix)

    with monkeypatch.context() as broken:
        broken.setattr(bench.artifacts, "delete_prefix", refuse)
        remove_files(bench.store.removals, bench.artifacts)
    assert bench.artifacts.exists(result_key(job.id, "person-1.bvh"))
    assert not bench.artifacts.exists(result_key(other.id, "person-1.bvh"))
    assert "removal_failed" in "".join(capfd.readouterr())
    remove_files(bench.store.removals, bench.artifacts)
    assert not bench.artifacts.exists(result_key(job.id, "person-1.bvh"))


def test_files_of_session_that_is_not_recorded_within_day_go(bench: RunnerBench) -> None:
    arriving, recorded = bench.store.sessions.reserve_id(), bench.store.sessions.reserve_id()
    for session_id in (arriving, recorded):
        bench.artifacts.put_bytes(record_key(session_id), b"record")
    bench.store.sessions.add("take", [], bench.session.preflight, recorded)
    remove_files(bench.store.removals, bench.artifacts)
    assert bench.artifacts.exists(record_key(arriving))
    database = Database(f"sqlite:///{bench.data_dir / 'multicap.db'}")
    with database.writing() as connection:
        connection.execute(sa.update(removals).values(due_at=removals.c.due_at - 86_400.0))
    database.close()
    remove_files(bench.store.removals, bench.artifacts)
    assert not bench.artifacts.exists(record_key(arriving))
    assert bench.artifacts.exists(record_key(recorded))
    with pytest.raises(Conflict):
        bench.store.sessions.add("take", [], bench.session.preflight, arriving)


def test_tables_may_be_made_later(tmp_path: Path) -> None:
    environment = os.environ | {"MULTICAP_DATA_DIR": str(tmp_path), "MULTICAP_REAP_INTERVAL_S": "0.05"}
    command = tied_to_parent([sys.executable, "-P", "-m", "worker.run.reaper"])
    log = tmp_path / "log"
    with log.open("w") as output, subprocess.Popen(command, env=environment, stdout=output, stderr=output) as reaper:
        wait_for(lambda: "waiting_for_database" in log.read_text())
        store = JobStore(f"sqlite:///{tmp_path / 'multicap.db'}")
        store.migrate()
        with sqlite3.connect(tmp_path / "multicap.db") as database:
            database.execute("INSERT INTO removals (prefix, due_at) VALUES ('sessions/gone/', 0)")
        wait_for(lambda: store.removals.due() == [])
        reaper.terminate()
        assert reaper.wait(60) == 0
        store.close()
    assert log.read_text().count("waiting_for_database") == 1
    assert "Traceback" not in log.read_text()
