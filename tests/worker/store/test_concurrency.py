"""Many workers at once: threads, processes, and a process that forks."""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.worker.store.conftest import LEASE_S, StoreBench
from worker.store.database.connection import Database
from worker.store.database.transitions import lock_job, move_chunk
from worker.store.errors import Conflict
from worker.store.model.states import ChunkState, JobState
from worker.store.store import JobStore

NUM_WORKERS, NUM_CHUNKS = 4, 40

# Claims whatever there is and finishes none of it; its word goes out at the end.
CLAIM_ALL = """
import json, sys
from worker.store.store import JobStore
store = JobStore(sys.argv[1])
sys.stdin.readline()
claims = iter(lambda: store.leases.claim("worker", 60), None)
print(json.dumps([claim.chunk_id for claim in claims]))
store.close()
"""


def test_threads_claim_every_chunk_once(jobs: StoreBench) -> None:
    for _ in range(2):
        jobs.queue(NUM_CHUNKS // 2)

    def claim_all(worker: int) -> list[int]:
        return [claim.chunk_id for claim in iter(lambda: jobs.store.leases.claim(f"worker {worker}", LEASE_S), None)]

    with ThreadPoolExecutor(NUM_WORKERS) as pool:
        claimed = [chunk_id for chunk_ids in pool.map(claim_all, range(NUM_WORKERS)) for chunk_id in chunk_ids]
    assert len(claimed) == len(set(claimed)) == NUM_CHUNKS


def test_processes_claim_every_chunk_once(jobs: StoreBench) -> None:
    for _ in range(2):
        jobs.queue(NUM_CHUNKS // 2)
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", CLAIM_ALL, jobs.url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(NUM_WORKERS)
    ]
    for worker in workers:
        assert worker.stdin is not None
        worker.stdin.write("go\n")
        worker.stdin.flush()
    claimed = [chunk_id for worker in workers for chunk_id in json.loads(worker.communicate(timeout=180)[0])]
    assert [worker.returncode for worker in workers] == [0] * NUM_WORKERS
    assert len(claimed) == len(set(claimed)) == NUM_CHUNKS


def test_finishes_at_once_open_next_stage_once(jobs: StoreBench, new_store: Callable[[], JobStore]) -> None:
    stores = [new_store() for _ in range(NUM_WORKERS)]
    for _ in range(5):
        job_id = jobs.queue(NUM_WORKERS).id
        claims = [jobs.claim() for _ in range(NUM_WORKERS)]
        with ThreadPoolExecutor(NUM_WORKERS) as pool:
            opened = pool.map(
                lambda store, claim: store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 1), stores, claims
            )
            assert Counter(opened) == {False: NUM_WORKERS - 1, True: 1}
        jobs.finish_all()
        assert jobs.store.jobs.get(job_id).state == JobState.SUCCEEDED


def test_report_that_waited_is_judged_by_present_rows(jobs: StoreBench) -> None:
    job_id = jobs.queue(1).id
    claim = jobs.claim()
    database = Database(jobs.url)
    with ThreadPoolExecutor(1) as pool:
        with database.writing() as connection:
            lock_job(connection, job_id)
            waiting = pool.submit(jobs.finish, claim)
            time.sleep(0.3)
            assert not waiting.done()
            move_chunk(connection, claim.chunk_id, ChunkState.READY)
        assert waiting.result() is False
    database.close()
    assert jobs.claim().chunk_id == claim.chunk_id


def test_jobs_with_all_calls_at_once_end(jobs: StoreBench, new_store: Callable[[], JobStore]) -> None:
    job_ids = [jobs.queue(6).id for _ in range(4)]

    def work(store: JobStore) -> None:
        bench = StoreBench(jobs.url, store, jobs.session_id)
        while claim := store.leases.claim("worker", LEASE_S):
            store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, LEASE_S)
            bench.finish(claim)

    def disturb(store: JobStore) -> None:
        for job_id in job_ids[::2]:
            with contextlib.suppress(Conflict):
                store.jobs.cancel(job_id)
            store.leases.reap(LEASE_S)

    with ThreadPoolExecutor(NUM_WORKERS) as pool:
        workers = [pool.submit(work, new_store()) for _ in range(NUM_WORKERS - 1)]
        pool.submit(disturb, new_store()).result()
        for worker in workers:
            worker.result()
    work(jobs.store)
    states = [jobs.store.jobs.get(job_id).state for job_id in job_ids]
    assert states[1::2] == [JobState.SUCCEEDED] * 2
    assert set(states[::2]) <= {JobState.SUCCEEDED, JobState.CANCELED}


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_store_is_carried_across_fork(jobs: StoreBench) -> None:
    jobs.queue(NUM_CHUNKS)
    jobs.claim()  # the parent has a connection
    children = [_fork(lambda: _claim_and_finish(jobs, 5)) for _ in range(3)]
    _claim_and_finish(jobs, 5)
    assert [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children] == [0, 0, 0]
    _claim_and_finish(jobs, 5)
    job = jobs.store.jobs.page()[0]
    assert job.stages[0].done == 25 * 10


def _claim_and_finish(jobs: StoreBench, num_chunks: int) -> None:
    for _ in range(num_chunks):
        jobs.finish(jobs.claim())


def _fork(act: Callable[[], None]) -> int:
    """Run something in a child that ends without a word to the test runner."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            act()
            status = 0
        finally:
            os._exit(status)
    return child
