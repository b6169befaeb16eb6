"""Health check of a worker's container: it looks for a row of the machine in the list of workers."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import wait_for
from worker.run import health
from worker.run.presence import Presence, process_name
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.store import JobStore


@pytest.fixture
def url(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("MULTICAP_DATA_DIR", str(tmp_path))
    return f"sqlite:///{tmp_path / 'multicap.db'}"


def test_machine_with_worker_is_healthy(url: str) -> None:
    store = JobStore(url)
    store.migrate()
    with pytest.raises(SystemExit, match="No worker process of this machine"):
        health.main()
    presence = Presence(store.workers, lambda: WorkerStatus(process_name(), WorkerState.STARTING, "It starts"))
    presence.start()
    wait_for(lambda: len(store.workers.all()) == 1)
    health.main()
    presence.stop()
    with pytest.raises(SystemExit, match="No worker process of this machine"):
        health.main()
    store.close()


def test_database_without_schema_is_no_stack_trace(url: str) -> None:
    done = subprocess.run([sys.executable, "-m", "worker.run.health"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "error: The database does not respond (OperationalError).\n"
