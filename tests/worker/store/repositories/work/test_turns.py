"""Tenants with equal shares take turns at each worker."""

from collections import Counter

from tests.worker.store.conftest import LEASE_S, StoreBench, stages
from worker.store.spec import JobSpec

TENANTS = ("one", "two", "three")


def test_tenants_take_turns_at_a_worker_that_works_on_one_chunk_at_a_time(jobs: StoreBench) -> None:
    for tenant in TENANTS:
        records = jobs.store.of(tenant)
        session_id = records.sessions.reserve_id()
        template = jobs.store.sessions.get(jobs.session_id)
        records.sessions.add("take", template.files, template.preflight, session_id)
        records.jobs.add(session_id, JobSpec(), stages(12))
    owners = []
    for _ in range(4 * len(TENANTS)):
        claim = jobs.store.leases.claim("worker", LEASE_S)
        assert claim is not None
        owners.append(claim.session_id)
        jobs.finish(claim)
    turns = [set(owners[k : k + len(TENANTS)]) for k in range(0, len(owners), len(TENANTS))]
    assert [len(turn) for turn in turns] == [len(TENANTS)] * 4
    assert set(Counter(owners).values()) == {4}
