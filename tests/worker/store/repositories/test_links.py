"""Links: what they open, how they end, and that their secrets are not kept."""

import pytest
import sqlalchemy as sa

from tests.worker.store.conftest import PREFLIGHT, StoreBench, stages
from worker.store.database import tables
from worker.store.database.quotas import Quotas
from worker.store.errors import Conflict, NotFound
from worker.store.model.rights import Actor, Link, LinkScope, Scope
from worker.store.repositories import links
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


def make_job(jobs: StoreBench, tenant: str, key_id: str | None = None) -> tuple[TenantRecords, str]:
    records = jobs.store.tenant(tenant, Quotas(), Actor(key_id, "request"))
    session_id = records.sessions.add("take", [], PREFLIGHT, jobs.store.sessions.reserve_id()).id
    return records, records.jobs.add(session_id, JobSpec(), stages(1)).id


def find(jobs: StoreBench, secret: str) -> Link | None:
    return jobs.store.link_secrets.find(secret)


def test_link_is_found_by_secret_alone(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "mine")
    link, secret = records.links.add(job_id, LinkScope.FILE, "person-1.bvh", 60.0)
    assert (link.tenant, link.job_id, link.scope, link.name) == ("mine", job_id, "file", "person-1.bvh")
    assert link.session_id == records.jobs.get(job_id).session_id
    assert (link.expires_at - link.created_at).total_seconds() == pytest.approx(60.0, abs=1.0)
    assert find(jobs, secret) == link
    for wrong in ("", secret[:-1], secret + "x", secret.swapcase(), link.id, "mcl_", "mc_" + secret[4:], "\udcff"):
        assert find(jobs, wrong) is None
    assert len(secret) >= len("mcl_") + 43  # 256 bits


def test_link_secret_is_not_stored(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "mine")
    _, secret = records.links.add(job_id, LinkScope.JOB, None, 60.0)
    engine = sa.create_engine(jobs.url)
    with engine.connect() as connection:
        rows = [
            str(dict(row._mapping))
            for table in tables.metadata.sorted_tables
            for row in connection.execute(sa.select(table))
        ]
    engine.dispose()
    assert any("link-created" in row for row in rows)
    assert not any(secret.removeprefix("mcl_") in row for row in rows)


def test_link_expired_is_invalid(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "mine")
    link, secret = records.links.add(job_id, LinkScope.EVENTS, None, -1.0)
    assert find(jobs, secret) is None
    assert records.links.list_valid(job_id) == []
    assert jobs.store.link_secrets.valid({link.id}) == set()
    with pytest.raises(NotFound):
        records.links.revoke(link.id)


def test_link_is_revoked_by_its_tenant_alone(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "mine")
    others, _ = make_job(jobs, "others")
    link, secret = records.links.add(job_id, LinkScope.JOB, None, 60.0)
    kept, kept_secret = records.links.add(job_id, LinkScope.EVENTS, None, 60.0)
    with pytest.raises(NotFound):
        others.links.revoke(link.id)
    assert records.links.list_valid(job_id) == [kept, link]
    assert jobs.store.link_secrets.valid({link.id, kept.id}) == {link.id, kept.id}
    records.links.revoke(link.id)
    assert find(jobs, secret) is None
    assert find(jobs, kept_secret) == kept
    assert jobs.store.link_secrets.valid({link.id, kept.id}) == {kept.id}
    acts = [(event.act, event.subject) for event in jobs.store.audit.events("mine")]
    assert acts[:3] == [("link-revoked", link.id), ("link-created", kept.id), ("link-created", link.id)]


def test_link_ends_with_job(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "mine")
    _, secret = records.links.add(job_id, LinkScope.JOB, None, 60.0)
    records.jobs.cancel(job_id)
    assert find(jobs, secret) is not None
    records.jobs.delete(job_id)
    assert find(jobs, secret) is None


def test_link_ends_with_key(jobs: StoreBench) -> None:
    key, _ = jobs.store.keys.add("mine", "portal", {Scope.WRITE})
    other, _ = jobs.store.keys.add("mine", "script", {Scope.WRITE})
    records, job_id = make_job(jobs, "mine", key.id)
    link, secret = records.links.add(job_id, LinkScope.JOB, None, 60.0)
    jobs.store.keys.revoke(other.id)
    assert find(jobs, secret) == link
    jobs.store.keys.revoke(key.id)
    assert find(jobs, secret) is None
    assert jobs.store.link_secrets.valid({link.id}) == set()


def test_link_without_key_ends_with_first_key(jobs: StoreBench) -> None:
    records, job_id = make_job(jobs, "default")
    _, secret = records.links.add(job_id, LinkScope.JOB, None, 60.0)
    assert find(jobs, secret) is not None
    jobs.store.keys.add("default", "portal", {Scope.READ})
    assert find(jobs, secret) is None


def test_links_of_job_are_limited(jobs: StoreBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "MAX_LINKS", 2)
    records, job_id = make_job(jobs, "mine")
    records.links.add(job_id, LinkScope.JOB, None, -1.0)
    for _ in range(2):
        records.links.add(job_id, LinkScope.JOB, None, 60.0)
    with pytest.raises(Conflict, match="2 links already"):
        records.links.add(job_id, LinkScope.JOB, None, 60.0)
