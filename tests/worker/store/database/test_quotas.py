"""At a quota, one over it, and after there is room again."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import PREFLIGHT, StoreBench, result, stages
from worker.store.database.quotas import Quotas
from worker.store.errors import QuotaExceeded
from worker.store.model.job_records import JobProblem
from worker.store.model.rights import Actor, Usage
from worker.store.model.session_records import InputFile
from worker.store.spec import JobSpec
from worker.store.store import JobStore
from worker.store.tenant_records import TenantRecords


def add_session(jobs: StoreBench, records: TenantRecords, num_bytes: int = 100) -> str:
    files = [InputFile("cam.mp4", "video", "sessions/x/inputs/0-cam.mp4", num_bytes, "1" * 64)]
    return records.sessions.add("take", files, PREFLIGHT, jobs.store.sessions.reserve_id()).id


def test_sessions(jobs: StoreBench) -> None:
    mine, theirs = (jobs.store.tenant(tenant, Quotas(sessions=2), Actor()) for tenant in ("mine", "theirs"))
    first = add_session(jobs, mine)
    add_session(jobs, mine)
    for refused in (lambda: add_session(jobs, mine), lambda: mine.require_room(0)):
        with pytest.raises(QuotaExceeded, match="At most 2 sessions") as error:
            refused()
        assert (error.value.name, error.value.limit, error.value.used) == ("sessions", 2, 2)
    assert len(mine.sessions.page()) == 2
    add_session(jobs, theirs)
    mine.sessions.delete(first)
    mine.require_room(10**12)
    add_session(jobs, mine)


def test_bytes(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(stored_bytes=1000), Actor())
    session_id = add_session(jobs, mine, 900)
    mine.require_room(100)
    with pytest.raises(QuotaExceeded):
        mine.require_room(101)
    full = add_session(jobs, mine, 100)
    with pytest.raises(QuotaExceeded, match="stored bytes"):
        add_session(jobs, mine, 1)
    mine.sessions.delete(full)
    # Work that was accepted is not stopped by what it leaves; the next session is.
    job = mine.jobs.add(session_id, JobSpec(), stages(1))
    jobs.finish(jobs.claim())
    jobs.finish(jobs.claim())
    expected = Usage(sessions=1, unfinished_jobs=0, stored_bytes=900 + 2 * 7 + result(job.id).num_bytes, uploads=0)
    assert mine.usage() == expected
    with pytest.raises(QuotaExceeded):
        add_session(jobs, mine, 100)
    mine.jobs.delete(job.id)
    assert mine.usage().stored_bytes == 914
    add_session(jobs, mine, 86)


def test_unfinished_jobs(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(unfinished_jobs=2), Actor())
    session_id = add_session(jobs, mine)
    first = mine.jobs.add(session_id, JobSpec(), stages(1))
    second = mine.jobs.add(session_id, JobSpec(), stages(1))
    claim = jobs.claim()
    with pytest.raises(QuotaExceeded, match="At most 2 unfinished jobs"):
        mine.jobs.add(session_id, JobSpec(), stages(1))
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    third = mine.jobs.add(session_id, JobSpec(), stages(1))
    with pytest.raises(QuotaExceeded):
        mine.jobs.retry(first.id, stages(1))
    mine.jobs.cancel(second.id)
    mine.jobs.retry(first.id, stages(1))
    assert {one.id for one in mine.jobs.page() if one.finished_at is None} == {first.id, third.id}


def test_quota_of_zero_refuses_all(jobs: StoreBench) -> None:
    with pytest.raises(QuotaExceeded):
        add_session(jobs, jobs.store.tenant("mine", Quotas(sessions=0), Actor()))


def test_quota_two_at_once_take_last_place_once(jobs: StoreBench, new_store: Callable[[], JobStore]) -> None:
    quotas = Quotas(unfinished_jobs=3)
    session_id = add_session(jobs, jobs.store.tenant("mine", quotas, Actor()))

    def try_it(store: JobStore) -> bool:
        try:
            store.tenant("mine", quotas, Actor()).jobs.add(session_id, JobSpec(), stages(1))
        except QuotaExceeded:
            return False
        return True

    stores = [new_store() for _ in range(8)]
    with ThreadPoolExecutor(len(stores)) as pool:
        assert sum(pool.map(try_it, stores)) == 3
