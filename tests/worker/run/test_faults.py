"""Faults of a running service: each part is killed during a job, which ends with the same bytes."""

import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
import valkey

from pipeline.core.options.providers import Provider
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.run.engine.code import stage_codes
from tests.waiting import is_alive, wait_for
from tests.worker.conftest import RESULT, RunnerBench, new_session, open_bench
from worker.run import embedded
from worker.run.planning import plan_job
from worker.store.database.totals import Total
from worker.store.model.job_records import JobRecord
from worker.store.model.states import FINISHED, JobState
from worker.store.model.work import WorkerState, WorkerStatus
from worker.store.queue import Queue, WorkQueue
from worker.store.spec import JobSpec

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="ties children to parents, and looks into /proc")

ROOT = Path(__file__).parents[3]


@dataclass
class SmallStageService:
    """Running service with small stages, and its store."""

    process: subprocess.Popen[bytes]
    data_dir: Path
    bench: RunnerBench

    def tree(self) -> list[psutil.Process]:
        supervisor = psutil.Process(self.process.pid)
        return [supervisor, *supervisor.children(recursive=True)]

    def part(self, word: str) -> psutil.Process:
        """Child of the supervisor with a word in its command line."""
        found = [one for one in psutil.Process(self.process.pid).children() if word in " ".join(one.cmdline())]
        assert len(found) == 1, f"{len(found)} children with {word}"
        return found[0]

    def is_whole(self) -> bool:
        """Return whether all parts run, and both children of the worker."""
        with contextlib.suppress(AssertionError, psutil.NoSuchProcess):
            return len(psutil.Process(self.process.pid).children()) == 3 and len(self.worker_children()) == 2
        return False

    def worker_children(self) -> list[psutil.Process]:
        return self.part("--worker").children()

    def start_job(self) -> JobRecord:
        job = self.bench.create_job()
        self.publish()
        return job

    def publish(self) -> bool:
        directory = embedded.DataDirectory(self.data_dir, self.data_dir / "broker" / "socket")
        return WorkQueue(directory.broker_url).publish()

    def wait_until_detecting(self, job: JobRecord) -> None:
        wait_for(lambda: self.bench.store.jobs.get(job.id).stages[1].done > 0)

    def detecting(self, job: JobRecord) -> tuple[int, list[int]]:
        """Number of chunks of the detection that are done, and processes of those that run."""
        with sqlite3.connect(self.data_dir / "multicap.db") as database:
            query = "SELECT state, worker FROM chunks WHERE job_id = ? AND stage = 'detect'"
            rows = database.execute(query, [job.id]).fetchall()
        running = [int(worker.rpartition(":")[2]) for state, worker in rows if state == "running"]
        return sum(state == "done" for state, _ in rows), running

    def pause_worker_of(self, job: JobRecord) -> psutil.Process:
        """Pause a worker that runs a chunk of the detection, between its transactions: SQLite has one lock for all."""
        while True:
            process = psutil.Process(self.detecting(job)[1][0])
            process.suspend()
            with contextlib.suppress(sqlite3.OperationalError):
                with contextlib.closing(sqlite3.connect(self.data_dir / "multicap.db", timeout=2.0)) as database:
                    database.execute("BEGIN IMMEDIATE")
                    database.rollback()
                if process.pid in self.detecting(job)[1]:  # it has not gone on to another stage meanwhile
                    return process
            process.resume()

    def wait_for_end(self, job: JobRecord, timeout_s: float = 300.0) -> JobRecord:
        wait_for(lambda: self.bench.store.jobs.get(job.id).state in FINISHED, timeout_s)
        return self.bench.store.jobs.get(job.id)


@pytest.fixture
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


def start(data_dir: Path) -> subprocess.Popen[bytes]:
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "LIGHT_FRAME_S": "0.15",
        "MULTICAP_LEASE_S": "3",
        "MULTICAP_HEARTBEAT_S": "0.3",
        "MULTICAP_REAP_INTERVAL_S": "1",
    }
    return subprocess.Popen(
        tied_to_parent([sys.executable, str(ROOT / "tests" / "worker" / "run" / "light_service.py"), str(data_dir)]),
        env=environment,
        stderr=subprocess.PIPE,
    )


@contextlib.contextmanager
def running_service(data_dir: Path) -> Iterator[SmallStageService]:
    """Run a service during the block; its leases are short, so that lost chunks are begun again soon."""
    bench = open_bench(data_dir)
    with start(data_dir) as process:
        try:
            running = SmallStageService(process, data_dir, bench)
            wait_for(running.is_whole)
            yield running
        finally:
            left = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            process.terminate()
            process.wait(30)
            wait_for(lambda: not any(is_alive(one) for one in left), timeout_s=120)
            bench.store.close()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SmallStageService]:
    """Service of all tests that end none of it for good: it takes seconds of processor time to start."""
    with running_service(tmp_path_factory.mktemp("data")) as running:
        yield running


@pytest.fixture
def service(shared: SmallStageService) -> SmallStageService:
    """The shared service, when each of its parts runs again, with a session of the test's own."""
    wait_for(shared.is_whole, timeout_s=120)
    shared.bench.session = new_session(shared.bench.store)
    return shared


def test_job_runs_on_both_children(service: SmallStageService) -> None:
    job = service.wait_for_end(service.start_job())
    assert job.state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT
    with sqlite3.connect(service.data_dir / "multicap.db") as database:
        chunks = database.execute("SELECT stage, chunk_index FROM chunks WHERE job_id = ?", [job.id]).fetchall()
    assert len(chunks) > 10
    # On a busy machine a chunk whose lease has ended is done twice.
    lines = (service.data_dir / "logs" / "worker.log").read_text().splitlines()
    log = [json.loads(line) for line in lines if line.startswith("{")]
    done = {(line["stage"], line["chunk"]) for line in log if line["event"] == "chunk_done" and line["job"] == job.id}
    assert done == set(chunks)


def test_lost_message_is_made_good(service: SmallStageService) -> None:
    job = service.bench.create_job()  # no message is published
    assert service.wait_for_end(job).state is JobState.SUCCEEDED


def test_message_lost_with_broker_is_made_good(service: SmallStageService) -> None:
    worker = service.part("--worker")
    worker.suspend()  # so that it can't take the message
    job = service.start_job()
    service.part("valkey-server").kill()
    published_s = time.monotonic()
    worker.resume()
    wait_for(lambda: service.bench.store.jobs.get(job.id).state is not JobState.QUEUED, timeout_s=120)
    assert time.monotonic() - published_s < 30
    assert service.wait_for_end(job).state is JobState.SUCCEEDED


def test_killed_child_costs_nothing_but_time(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    before = service.worker_children()
    before[0].kill()
    assert service.wait_for_end(job).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT
    wait_for(lambda: len(service.worker_children()) == 2)
    # A connection to the broker that the new child kept would keep the main process busy once the broker restarts.
    main = sockets(service.part("--worker"))
    assert main
    wait_for(lambda: not any(sockets(child) & main for child in service.worker_children()))


def sockets(process: psutil.Process) -> set[str]:
    """Sockets that a process has open, as the kernel names them."""
    opened = set()
    for entry in Path(f"/proc/{process.pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # it was closed meanwhile
            opened.add(str(entry.readlink()))
    return {name for name in opened if name.startswith("socket:")}


def test_paused_worker_loses_its_lease_and_changes_nothing_later(service: SmallStageService) -> None:
    job = service.start_job()
    wait_for(lambda: len(service.detecting(job)[1]) > 0)
    paused = service.pause_worker_of(job)
    try:
        assert service.wait_for_end(job).state is JobState.SUCCEEDED
    finally:
        paused.resume()
    assert service.bench.result(job.id) == RESULT
    assert service.bench.store.figures().totals[Total.LEASES_LOST, "detect"] >= 1.0
    assert service.wait_for_end(service.start_job()).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT


def test_worker_passes_on_message_for_work_that_needs_gpu(service: SmallStageService) -> None:
    gpu = Provider("cuda", "1.31.1", "NVIDIA H200")
    codes = tuple(sorted(stage_codes(gpu.identity).values()))
    ready = WorkerStatus("gpu:1", WorkerState.READY, "A worker works", codes=codes, provider=gpu)
    service.bench.store.workers.report(ready)
    stages = plan_job(service.bench.session, JobSpec(), provider=gpu.identity)
    job = service.bench.store.jobs.add(service.bench.session.id, JobSpec(), stages)
    with valkey.Valkey(unix_socket_path=str(service.data_dir / "broker" / "socket")) as broker:
        service.publish()
        wait_for(lambda: broker.llen(Queue.GPU) > 0)
    # When no worker has a GPU any more, the job is planned for the others.
    assert service.wait_for_end(job).state is JobState.SUCCEEDED


def test_killed_worker_is_replaced_and_its_children_are_gone(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    worker = service.part("--worker")
    children = worker.children()
    worker.kill()
    wait_for(lambda: not any(is_alive(child) for child in children), timeout_s=120)
    assert service.wait_for_end(job).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT


def test_killed_broker_is_replaced(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    service.part("valkey-server").kill()
    assert service.wait_for_end(job).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT
    # The worker receives messages of the new broker.
    assert service.wait_for_end(service.start_job()).state is JobState.SUCCEEDED


def test_cancel_ends_within_seconds(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    service.bench.store.jobs.cancel(job.id)
    assert service.wait_for_end(job).state is JobState.CANCELED


def test_stop_gives_chunks_back_and_next_start_continues(data_dir: Path) -> None:
    bench = open_bench(data_dir)
    with start(data_dir) as process:
        running = SmallStageService(process, data_dir, bench)
        wait_for(lambda: len(psutil.Process(process.pid).children()) == 3)
        job = running.start_job()
        running.wait_until_detecting(job)
        tree = running.tree()
        process.send_signal(signal.SIGINT)
        assert process.wait(15) == 0
    assert not any(is_alive(one) for one in tree)
    with start(data_dir) as process:
        assert SmallStageService(process, data_dir, bench).wait_for_end(job).state is JobState.SUCCEEDED
        process.terminate()
        assert process.wait(15) == 0
    assert bench.result(job.id) == RESULT
    bench.store.close()


def test_killed_supervisor_leaves_no_orphan(data_dir: Path) -> None:
    bench = open_bench(data_dir)
    with start(data_dir) as process:
        running = SmallStageService(process, data_dir, bench)
        wait_for(lambda: len(psutil.Process(process.pid).children()) == 3)
        running.wait_until_detecting(running.start_job())
        tree = running.tree()
        assert len(tree) == 1 + 3 + 2
        process.kill()
    wait_for(lambda: not any(is_alive(one) for one in tree), timeout_s=120)
    bench.store.close()
