"""Requests that come again are answered once."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.worker.store.conftest import PREFLIGHT, StoreBench, stages
from worker.store.database.quotas import Quotas
from worker.store.database.tables import idempotency_keys
from worker.store.errors import Conflict, KeyBusy, KeyReused
from worker.store.model.job_records import JobRecord
from worker.store.model.rights import Actor
from worker.store.repositories.idempotency_keys import KeyClaim
from worker.store.spec import JobSpec
from worker.store.store import JobStore
from worker.store.tenant_records import TenantRecords


def of(jobs: StoreBench, tenant: str = "default") -> TenantRecords:
    return jobs.store.tenant(tenant, Quotas(), Actor())


def answer_of(job: JobRecord) -> dict[str, Any]:
    return {"status": 202, "headers": {"Location": f"/v1/jobs/{job.id}"}, "body": f'{{"id": "{job.id}"}}'}


def claim(records: TenantRecords, key: str = "key", fingerprint: str = "f" * 64, lease_s: float = 60.0) -> KeyClaim:
    claimed = records.idempotency_keys.claim(key, fingerprint, lease_s)
    assert isinstance(claimed, KeyClaim)
    return claimed


def make(jobs: StoreBench, records: TenantRecords, claimed: KeyClaim) -> JobRecord:
    with records.transaction() as work:
        job = work.jobs.add(jobs.session_id, JobSpec(), stages(1))
        work.idempotency_keys.answer(claimed, answer_of(job))
    return job


def test_key_sent_again_gets_first_answer(jobs: StoreBench) -> None:
    records = of(jobs)
    assert not records.idempotency_keys.is_answered("key")
    job = make(jobs, records, claim(records))
    assert records.idempotency_keys.claim("key", "f" * 64, 60.0) == answer_of(job)
    assert records.idempotency_keys.is_answered("key")
    assert len(records.jobs.page()) == 1


def test_another_request_under_key_is_refused(jobs: StoreBench) -> None:
    records = of(jobs)
    claimed = claim(records)
    for _ in ("while it runs", "and when it was answered"):
        with pytest.raises(KeyReused):
            records.idempotency_keys.claim("key", "e" * 64, 60.0)
        if not records.idempotency_keys.is_answered("key"):
            make(jobs, records, claimed)


def test_while_it_is_answered_nobody_else_answers(jobs: StoreBench, new_store: Callable[[], JobStore]) -> None:
    stores = [new_store() for _ in range(8)]

    def try_it(store: JobStore) -> object:
        try:
            return store.tenant("default").idempotency_keys.claim("key", "f" * 64, 60.0)
        except KeyBusy:
            return None

    with ThreadPoolExecutor(len(stores)) as pool:
        tokens = [token for token in pool.map(try_it, stores) if token is not None]
    assert len(tokens) == 1


def test_key_of_failed_request_can_be_claimed_again(jobs: StoreBench) -> None:
    records = of(jobs)
    claimed = claim(records)
    records.idempotency_keys.release(claimed)
    make(jobs, records, claim(records, fingerprint="e" * 64))
    records.idempotency_keys.release(claimed)  # of another try: nothing happens
    assert records.idempotency_keys.is_answered("key")


def test_claim_run_out_stores_no_answer(jobs: StoreBench) -> None:
    records = of(jobs)
    slow = claim(records, lease_s=-1.0)
    quick = claim(records)
    records.idempotency_keys.renew(slow, 60.0)
    with pytest.raises(Conflict):
        make(jobs, records, slow)
    job = make(jobs, records, quick)
    assert [one.id for one in records.jobs.page()] == [job.id]


def test_claim_renewed_stays(jobs: StoreBench) -> None:
    records = of(jobs)
    claimed = claim(records, lease_s=-1.0)
    records.idempotency_keys.renew(claimed, 60.0)
    with pytest.raises(KeyBusy):
        records.idempotency_keys.claim("key", "f" * 64, 60.0)


def test_tenants_have_keys_of_their_own(jobs: StoreBench) -> None:
    mine, theirs = of(jobs, "mine"), of(jobs, "theirs")
    assert isinstance(mine.idempotency_keys.claim("key", "f" * 64, 60.0), KeyClaim)
    assert isinstance(theirs.idempotency_keys.claim("key", "e" * 64, 60.0), KeyClaim)


def test_after_day_it_is_forgotten(jobs: StoreBench) -> None:
    records = of(jobs)
    make(jobs, records, claim(records))
    jobs.execute(idempotency_keys.update().values(expires_at=0.0))
    make(jobs, records, claim(records, fingerprint="e" * 64))
    assert len(records.jobs.page()) == 2


def add_both(jobs: StoreBench, work: TenantRecords) -> None:
    session = work.sessions.add("take", [], PREFLIGHT, work.sessions.reserve_id())
    work.jobs.add(session.id, JobSpec(), stages(1))


Act = Callable[[StoreBench, TenantRecords], Any]
ACTS: dict[str, Act] = {
    "cancel": lambda jobs, work: work.jobs.cancel(work.jobs.page()[0].id),
    "session": lambda jobs, work: work.sessions.add("take", [], PREFLIGHT, work.sessions.reserve_id()),
    "upload": lambda jobs, work: work.uploads.add("0190", "cam.mp4", 5, "", 60.0, "host:/uploads"),
    "both": add_both,
}


@pytest.mark.parametrize("act", ACTS)
def test_answer_and_deed_come_together_or_not_at_all(jobs: StoreBench, act: str) -> None:
    records = of(jobs)
    jobs.queue()
    claimed = claim(records)

    def everything() -> object:
        return records.usage(), [job.state for job in records.jobs.page()], jobs.store.audit.events()

    def act_and_fail() -> None:
        with records.transaction() as work:
            ACTS[act](jobs, work)
            work.idempotency_keys.answer(claimed, {})
            raise ZeroDivisionError

    before = everything()
    with pytest.raises(ZeroDivisionError):
        act_and_fail()
    assert everything() == before
    assert not records.idempotency_keys.is_answered("key")
    with records.transaction() as work:
        ACTS[act](jobs, work)
        work.idempotency_keys.answer(claimed, {"status": 201})
    assert everything() != before
    assert records.idempotency_keys.is_answered("key")


def test_key_with_claim_run_out_is_free(jobs: StoreBench) -> None:
    """Nothing was done under it."""
    records = of(jobs)
    lost = claim(records, lease_s=-1.0)
    job = make(jobs, records, claim(records, fingerprint="e" * 64))
    with pytest.raises(Conflict):
        make(jobs, records, lost)
    assert records.idempotency_keys.claim("key", "e" * 64, 60.0) == answer_of(job)


def test_answers_that_name_what_was_deleted_are_forgotten(jobs: StoreBench) -> None:
    records, others = of(jobs), of(jobs, "others")
    job = make(jobs, records, claim(records))
    for owner, key, body in (
        *((records, "session", jobs.session_id), (records, "calibration", "rig")),
        (others, "theirs", jobs.session_id),
    ):
        claimed = claim(owner, key)
        owner.idempotency_keys.answer(claimed, {"status": 201, "headers": {}, "body": body})
    jobs.finish_all()
    records.jobs.delete(job.id)
    assert not records.idempotency_keys.is_answered("key")
    assert records.idempotency_keys.is_answered("session")
    records.sessions.delete(jobs.session_id)
    assert not records.idempotency_keys.is_answered("session")
    assert records.idempotency_keys.is_answered("calibration")
    assert others.idempotency_keys.is_answered("theirs")
