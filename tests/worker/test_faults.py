"""Faults of a running service: each part is killed during a job, which ends with the same bytes."""

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

from pipeline.runtime.parent_watch import tied_to_parent
from tests.waiting import is_alive, wait_for
from tests.worker.conftest import RESULT, RunnerBench, open_bench
from worker.jobs.model.jobs import JobRecord
from worker.jobs.model.states import FINISHED, JobState
from worker.jobs.queue import WorkQueue
from worker.process import embedded

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="ties children to parents, and looks into /proc")

ROOT = Path(__file__).parents[2]


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

    def wait_for_end(self, job: JobRecord, timeout_s: float = 60.0) -> JobRecord:
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
        tied_to_parent([sys.executable, str(ROOT / "tests" / "worker" / "light_service.py"), str(data_dir)]),
        env=environment,
        stderr=subprocess.PIPE,
    )


@pytest.fixture
def service(data_dir: Path) -> Iterator[SmallStageService]:
    bench = open_bench(data_dir)
    with start(data_dir) as process:
        try:
            running = SmallStageService(process, data_dir, bench)
            wait_for(lambda: len(psutil.Process(process.pid).children()) == 3 and len(running.worker_children()) == 2)
            yield running
        finally:
            left = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            process.terminate()
            process.wait(30)
            wait_for(lambda: not any(is_alive(one) for one in left), timeout_s=120)
            bench.store.close()


def test_a_job_runs_on_both_children(service: SmallStageService) -> None:
    job = service.wait_for_end(service.start_job())
    assert job.state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT
    log = (service.data_dir / "logs" / "worker.log").read_text()
    with sqlite3.connect(service.data_dir / "multicap.db") as database:
        ((num_chunks,),) = database.execute("SELECT COUNT(*) FROM chunks WHERE job_id = ?", [job.id]).fetchall()
    assert log.count("chunk_done") == num_chunks > 10


def test_a_lost_message_is_made_good(service: SmallStageService) -> None:
    job = service.bench.create_job()  # no message is published
    assert service.wait_for_end(job).state is JobState.SUCCEEDED


def test_a_message_lost_with_the_broker_is_made_good(service: SmallStageService) -> None:
    worker = service.part("--worker")
    worker.suspend()  # so that it can't take the message
    job = service.start_job()
    service.part("valkey-server").kill()
    published_s = time.monotonic()
    worker.resume()
    wait_for(lambda: service.bench.store.jobs.get(job.id).state is not JobState.QUEUED, timeout_s=120)
    assert time.monotonic() - published_s < 30
    assert service.wait_for_end(job).state is JobState.SUCCEEDED


def test_a_killed_child_costs_nothing_but_time(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    before = service.worker_children()
    before[0].kill()
    assert service.wait_for_end(job).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT
    wait_for(lambda: len(service.worker_children()) == 2)


def test_a_killed_worker_is_replaced_and_its_children_are_gone(service: SmallStageService) -> None:
    job = service.start_job()
    service.wait_until_detecting(job)
    worker = service.part("--worker")
    children = worker.children()
    worker.kill()
    wait_for(lambda: not any(is_alive(child) for child in children), timeout_s=120)
    assert service.wait_for_end(job).state is JobState.SUCCEEDED
    assert service.bench.result(job.id) == RESULT


def test_a_killed_broker_is_replaced(service: SmallStageService) -> None:
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
    assert service.wait_for_end(job, timeout_s=120).state is JobState.CANCELED


def test_a_stop_gives_chunks_back_and_the_next_start_goes_on(data_dir: Path) -> None:
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


def test_a_killed_supervisor_leaves_no_orphan(data_dir: Path) -> None:
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
