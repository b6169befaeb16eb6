"""Records of uploads; their bytes are the API's."""

import pytest
from uuid_utils import uuid7

from tests.worker.store.conftest import PREFLIGHT, StoreBench, stages
from worker.store.database.quotas import Quotas
from worker.store.database.tables import uploads
from worker.store.errors import Conflict, NotFound, QuotaExceeded
from worker.store.model.rights import Actor
from worker.store.model.session_records import Session
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords

HOUR_S = 3600.0


def of(jobs: StoreBench, tenant: str = "mine", quotas: Quotas | None = None) -> TenantRecords:
    return jobs.store.tenant(tenant, quotas or Quotas(), Actor("key", "request"))


def begin(records: TenantRecords, num_bytes: int = 100) -> str:
    return records.uploads.add(
        str(uuid7()), "cam_0.mp4", num_bytes, "filename Y2FtXzAubXA0", HOUR_S, "host:/uploads"
    ).id


def expire(jobs: StoreBench, upload_id: str) -> None:
    jobs.execute(uploads.update().where(uploads.c.id == upload_id).values(expires_at=0.0))


def test_upload_is_read_as_announced(jobs: StoreBench) -> None:
    mine = of(jobs)
    upload = mine.uploads.add(
        str(uuid7()), "cam_0.mp4", 5_000_000_000, "filename Y2FtXzAubXA0", HOUR_S, "host:/uploads"
    )
    assert mine.uploads.get(upload.id) == upload
    assert (upload.name, upload.num_bytes, upload.metadata) == ("cam_0.mp4", 5_000_000_000, "filename Y2FtXzAubXA0")
    assert mine.uploads.renew(upload.id, 2 * HOUR_S).expires_at > upload.expires_at


@pytest.mark.parametrize("act", ["get", "delete", "renew"])
def test_another_tenant_s_is_not_there(jobs: StoreBench, act: str) -> None:
    upload_id = begin(of(jobs, "theirs"))
    arguments = [HOUR_S] if act == "renew" else []
    for records in (of(jobs, "mine"), of(jobs, "nobody")):
        with pytest.raises(NotFound):
            getattr(records.uploads, act)(upload_id, *arguments)
    assert of(jobs, "mine").uploads.known([upload_id]) == set()
    assert of(jobs, "theirs").uploads.get(upload_id).id == upload_id


def test_upload_deleted_is_unknown(jobs: StoreBench) -> None:
    mine = of(jobs)
    upload_id = begin(mine)
    mine.uploads.delete(upload_id)
    for act in (mine.uploads.get, mine.uploads.delete):
        with pytest.raises(NotFound):
            act(upload_id)
    assert [event.act for event in jobs.store.audit.events("mine")] == ["upload-deleted", "upload-created"]


def test_upload_expired_is_unknown(jobs: StoreBench) -> None:
    mine = of(jobs)
    old, new = begin(mine), begin(mine)
    expire(jobs, old)
    with pytest.raises(NotFound):
        mine.uploads.get(old)
    with pytest.raises(NotFound):
        mine.uploads.renew(old, HOUR_S)
    assert jobs.store.uploads.expired() == [old]
    for upload_id in (old, new):
        jobs.store.uploads.delete_expired(upload_id)
    assert jobs.store.uploads.known([old, new]) == {new}


def test_session_uses_all_uploads_or_is_not_added(jobs: StoreBench) -> None:
    mine, theirs = of(jobs), of(jobs, "theirs")
    first, second, other = begin(mine), begin(mine), begin(theirs)

    def make(*upload_ids: str) -> Session:
        session_id = jobs.store.sessions.reserve_id()
        with mine.transaction() as work:
            work.uploads.use(upload_ids)
            return work.sessions.add("take", [], PREFLIGHT, session_id)

    with pytest.raises(Conflict):
        make(first, other)
    assert mine.sessions.page() == []
    assert mine.uploads.get(first).id == first
    make(first, second)
    assert mine.usage().uploads == 0
    with pytest.raises(Conflict):
        make(first)
    assert len(mine.sessions.page()) == 1
    assert theirs.uploads.get(other).id == other


def test_session_and_job_come_together_or_not_at_all(jobs: StoreBench) -> None:
    mine = of(jobs, quotas=Quotas(unfinished_jobs=1))
    upload_id = begin(mine)

    def make(*upload_ids: str) -> str:
        session_id = jobs.store.sessions.reserve_id()
        with mine.transaction() as work:
            work.uploads.use(upload_ids)
            work.sessions.add("take", [], PREFLIGHT, session_id)
            return work.jobs.add(session_id, JobSpec(), stages(2)).id

    job_id = make()
    assert mine.jobs.get(job_id).stages[0].total == 20
    with pytest.raises(QuotaExceeded):
        make(upload_id)
    assert len(mine.sessions.page()) == 1
    assert mine.uploads.get(upload_id).id == upload_id
    mine.jobs.cancel(job_id)
    make(upload_id)


def test_quotas(jobs: StoreBench) -> None:
    mine = of(jobs, quotas=Quotas(uploads=2, stored_bytes=1000))
    first = begin(mine, 100)
    with pytest.raises(QuotaExceeded, match="stored bytes"):
        begin(mine, 901)
    begin(mine, 900)
    with pytest.raises(QuotaExceeded, match="At most 2 uploads"):
        begin(mine, 0)
    begin(of(jobs, "theirs", Quotas(uploads=2, stored_bytes=1000)), 1000)
    mine.uploads.delete(first)
    begin(mine, 100)
    assert (mine.usage().uploads, mine.usage().stored_bytes) == (2, 1000)


def test_upload_used_by_session_counts_once_for_quota(jobs: StoreBench) -> None:
    mine = of(jobs, quotas=Quotas(uploads=1, stored_bytes=100))
    upload_id = begin(mine, 100)
    session_id = jobs.store.sessions.reserve_id()
    with mine.transaction() as work:
        work.uploads.use([upload_id])
        session = work.sessions.add("take", [], PREFLIGHT, session_id)
    assert mine.sessions.get(session.id) == session
    begin(mine, 100)
