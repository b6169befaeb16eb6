"""Row of a worker process in the list of workers."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from tests.waiting import wait_for
from tests.worker.conftest import RunnerBench
from worker.run.presence import Presence, process_name, remove_abandoned, remove_killed, scratch_folder
from worker.store.model.work import WorkerState, WorkerStatus

STARTING = WorkerStatus(process_name(), WorkerState.STARTING, "A worker loads its libraries")


def test_change_is_told_at_once_and_end_too(bench: RunnerBench) -> None:
    now: list[WorkerStatus | None] = [STARTING]
    presence = Presence(bench.store.workers, lambda: now[0])
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    ready = replace(STARTING, state=WorkerState.READY, detectors=("movenet-multipose",))
    now[0] = ready
    changed_s = time.monotonic()
    wait_for(lambda: bench.store.workers.all() == [ready])
    assert time.monotonic() - changed_s < 1.5
    # A worker that shuts down leaves the list long before its process ends.
    now[0] = None
    wait_for(lambda: bench.store.workers.all() == [])
    presence.stop()


def test_stopping_takes_process_off_list(bench: RunnerBench) -> None:
    presence = Presence(bench.store.workers, lambda: STARTING)
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    presence.stop()
    assert bench.store.workers.all() == []


@pytest.mark.slow
def test_database_that_is_away_is_told_as_soon_as_it_is_back(bench: RunnerBench) -> None:
    class UnreachableWorkers:
        tries = 0

        def report(self, status: WorkerStatus) -> None:
            self.tries += 1
            if self.tries == 1:
                raise OperationalError("", {}, Exception("away"))
            bench.store.workers.report(status)

        def remove(self, worker_ids: Collection[str]) -> None:
            bench.store.workers.remove(worker_ids)

    workers = UnreachableWorkers()
    presence = Presence(workers, lambda: STARTING)  # type: ignore[arg-type]
    presence.start()
    wait_for(lambda: bench.store.workers.all() == [STARTING])
    assert workers.tries == 2
    presence.stop()


def test_killed_processes_of_this_machine_are_taken_off_list(bench: RunnerBench) -> None:
    host = process_name().rpartition(":")[0]
    killed = replace(STARTING, id=f"{host}:4194304")  # beyond the largest process id
    elsewhere = replace(STARTING, id="another-machine:4194304")
    for status in (STARTING, killed, elsewhere):
        bench.store.workers.report(status)
    remove_killed(bench.store.workers)
    assert {worker.id for worker in bench.store.workers.all()} == {STARTING.id, elsewhere.id}


LEAVE_A_FOLDER = """
import os, signal
from worker.run.presence import scratch_folder
with scratch_folder() as folder:
    (folder / "person-1.bvh").write_bytes(b"HIERARCHY")
    print(folder, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(autouse=True)
def temporary_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_folder_is_gone_after_its_block(temporary_dir: Path) -> None:
    with scratch_folder() as folder:
        (folder / "person-1.bvh").write_bytes(b"HIERARCHY")
        assert folder.parent == temporary_dir
    assert list(temporary_dir.iterdir()) == []


def test_folders_of_killed_processes_go_and_nothing_else(temporary_dir: Path) -> None:
    kept = ["multicap-notes", f"multicap-{2**70}-other", "multicap-1-init", "other-99999999-x"]
    for name in kept:
        (temporary_dir / name).mkdir()
    killed = subprocess.run(
        [sys.executable, "-c", LEAVE_A_FOLDER],
        env=os.environ | {"TMPDIR": str(temporary_dir)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert Path(killed.stdout.strip()).is_dir()
    with scratch_folder() as mine:
        remove_abandoned()
        assert sorted(path.name for path in temporary_dir.iterdir()) == sorted([*kept, mine.name])
