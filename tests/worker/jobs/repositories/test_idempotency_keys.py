"""Requests that come again are answered once."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.worker.jobs.conftest import PREFLIGHT, Bench, stages
from worker.jobs.database.quotas import Quotas
from worker.jobs.database.tables import receipts
from worker.jobs.errors import Conflict, KeyBusy, KeyReused
from worker.jobs.model import Actor, Job
from worker.jobs.repositories.idempotency_keys import Answer, Claim
from worker.jobs.repositories.records import Records
from worker.jobs.spec import JobSpec
from worker.jobs.store import JobStore


def of(jobs: Bench, tenant: str = "default") -> Records:
    return jobs.store.of(tenant, Quotas(), Actor())


def render(job: Job) -> Answer:
    return Answer(202, {"Location": f"/v1/jobs/{job.id}"}, f'{{"id": "{job.id}"}}')


def claim(records: Records, key: str = "key", fingerprint: str = "f" * 64, lease_s: float = 60.0) -> Claim:
    token = records.claim_key(key, fingerprint, lease_s)
    assert isinstance(token, str)
    return Claim(key, token, render)


def make(jobs: Bench, records: Records, claimed: Claim) -> Job:
    return records.answering(claimed).create_job(jobs.session_id, JobSpec(), stages(1))


def test_the_first_answer_comes_again(jobs: Bench) -> None:
    records = of(jobs)
    assert not records.has_receipt("key")
    job = make(jobs, records, claim(records))
    assert records.claim_key("key", "f" * 64, 60.0) == render(job)
    assert records.has_receipt("key")
    assert len(records.jobs()) == 1


def test_another_request_under_the_key_is_refused(jobs: Bench) -> None:
    records = of(jobs)
    claimed = claim(records)
    for _ in ("while it runs", "and when it was answered"):
        with pytest.raises(KeyReused):
            records.claim_key("key", "e" * 64, 60.0)
        if not records.has_receipt("key"):
            make(jobs, records, claimed)


def test_while_it_is_answered_nobody_else_answers(jobs: Bench, new_store: Callable[[], JobStore]) -> None:
    stores = [new_store() for _ in range(8)]

    def try_it(store: JobStore) -> object:
        try:
            return store.of("default", Quotas(), Actor()).claim_key("key", "f" * 64, 60.0)
        except KeyBusy:
            return None

    with ThreadPoolExecutor(len(stores)) as pool:
        tokens = [token for token in pool.map(try_it, stores) if token is not None]
    assert len(tokens) == 1


def test_what_came_to_nothing_may_be_tried_again(jobs: Bench) -> None:
    records = of(jobs)
    claimed = claim(records)
    records.release_claim("key", claimed.token)
    make(jobs, records, claim(records, fingerprint="e" * 64))
    records.release_claim("key", claimed.token)  # of another try: nothing happens
    assert records.has_receipt("key")


def test_who_was_thought_dead_does_nothing(jobs: Bench) -> None:
    records = of(jobs)
    slow = claim(records, lease_s=-1.0)
    quick = claim(records)
    records.renew_claim("key", slow.token, 60.0)
    with pytest.raises(Conflict):
        make(jobs, records, slow)
    job = make(jobs, records, quick)
    assert [one.id for one in records.jobs()] == [job.id]


def test_a_claim_that_is_renewed_stays(jobs: Bench) -> None:
    records = of(jobs)
    claimed = claim(records, lease_s=-1.0)
    records.renew_claim("key", claimed.token, 60.0)
    with pytest.raises(KeyBusy):
        records.claim_key("key", "f" * 64, 60.0)


def test_tenants_have_keys_of_their_own(jobs: Bench) -> None:
    mine, theirs = of(jobs, "mine"), of(jobs, "theirs")
    assert isinstance(mine.claim_key("key", "f" * 64, 60.0), str)
    assert isinstance(theirs.claim_key("key", "e" * 64, 60.0), str)


def test_after_a_day_it_is_forgotten(jobs: Bench) -> None:
    records = of(jobs)
    make(jobs, records, claim(records))
    jobs.execute(receipts.update().values(expires_at=0.0))
    make(jobs, records, claim(records, fingerprint="e" * 64))
    assert len(records.jobs()) == 2


Act = Callable[[Bench, Records], Any]
ACTS: dict[str, Act] = {
    "cancel": lambda jobs, records: records.cancel(jobs.queue().id),
    "session": lambda jobs, records: records.create_session("take", [], {}, jobs.store.announce_session()),
    "upload": lambda jobs, records: records.create_upload("0190", "cam.mp4", 5, "", 60.0),
    "both": lambda jobs, records: records.create_session_and_job(
        "take", [], PREFLIGHT, jobs.store.announce_session(), [], JobSpec(), stages(1)
    ),
}


@pytest.mark.parametrize("act", ACTS)
def test_answer_and_deed_come_together_or_not_at_all(jobs: Bench, act: str) -> None:
    records = of(jobs)
    token = claim(records).token

    def fail(made: object) -> Answer:
        raise ZeroDivisionError

    before = records.usage(), [job.state for job in records.jobs()]
    with pytest.raises(ZeroDivisionError):
        ACTS[act](jobs, records.answering(Claim("key", token, fail)))
    after = records.usage(), [job.state for job in records.jobs()]
    assert after == before or act == "cancel"
    assert "canceled" not in after[1]
    assert not records.has_receipt("key")
    ACTS[act](jobs, records.answering(Claim("key", token, lambda made: Answer(201, {}, made.id))))
    assert records.has_receipt("key")


def test_a_key_whose_claim_ran_out_is_free_for_any_request(jobs: Bench) -> None:
    """Nothing was done under it."""
    records = of(jobs)
    lost = claim(records, lease_s=-1.0)
    job = make(jobs, records, claim(records, fingerprint="e" * 64))
    with pytest.raises(Conflict):
        make(jobs, records, lost)
    assert records.claim_key("key", "e" * 64, 60.0) == render(job)
