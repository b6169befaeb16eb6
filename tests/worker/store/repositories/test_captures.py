"""Sessions as captures: searched, renamed, with their jobs."""

import pytest

from pipeline.core.options.job_choices import PROXY_KIND, CalibrationChoices, ProxyChoices
from tests.worker.store.conftest import CODE, PREFLIGHT, UNITS, StoreBench, stages
from worker.store.errors import Conflict
from worker.store.model.job_records import NewestJob, Result, job_kind
from worker.store.model.states import JobState
from worker.store.model.work import ChunkPlan, StagePlan
from worker.store.spec import JobSpec
from worker.store.tenant_records import TenantRecords


@pytest.fixture
def records(jobs: StoreBench) -> TenantRecords:
    return jobs.store.tenant("studio")


def add(jobs: StoreBench, records: TenantRecords, name: str) -> str:
    return records.sessions.add(name, [], PREFLIGHT, jobs.store.sessions.reserve_id()).id


def names(records: TenantRecords, name: str) -> list[str]:
    return [one.session.name for one in records.sessions.page(name=name)]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("hand", ["Handshake, take 3"]),
        ("TAKE", ["take_2", "Handshake, take 3"]),
        ("straße", ["STRASSE 5"]),
        ("ÉCOLE", ["École"]),
        ("e\u0301cole", ["École"]),
        ("100%", ["100% done"]),
        ("%", ["100% done"]),
        ("_", ["take_2"]),
        ("\\", []),
        ("nothing", []),
    ],
)
def test_search_by_name(jobs: StoreBench, records: TenantRecords, text: str, found: list[str]) -> None:
    for name in ("Handshake, take 3", "take_2", "STRASSE 5", "École", "100% done"):
        add(jobs, records, name)
    add(jobs, jobs.store.tenant("other"), "Handshake of others, take 100%_\\ École STRASSE")
    assert names(records, text) == found


def test_session_renamed_is_found_by_new_name_alone(jobs: StoreBench, records: TenantRecords) -> None:
    session_id = add(jobs, records, "Walk")
    job = records.jobs.add(session_id, JobSpec(), stages(1))
    assert records.sessions.rename(session_id, "Gehen ß").session.name == "Gehen ß"
    assert (names(records, "walk"), names(records, "gehen SS")) == ([], ["Gehen ß"])
    assert records.jobs.get(job.id).session_name == "Gehen ß"


def test_captures_have_their_newest_reconstruction(jobs: StoreBench, records: TenantRecords) -> None:
    first, second = add(jobs, records, "first"), add(jobs, records, "second")
    one, two = (records.jobs.add(first, JobSpec(), stages(1)).id for _ in range(2))
    making = records.jobs.add(first, JobSpec(), stages(1), making=CalibrationChoices(None, stature_m=(1.8,)))
    records.jobs.cancel(one)
    found = records.sessions.page()
    assert [(capture.session.id, capture.num_jobs, capture.newest_job) for capture in found] == [
        (second, 0, None),
        (first, 2, NewestJob(two, JobState.QUEUED)),
    ]
    assert records.sessions.capture(first) == found[1]
    assert [capture.session.id for capture in records.sessions.page(state=JobState.QUEUED)] == [first]
    assert records.sessions.page(state=JobState.CANCELED) == []
    with pytest.raises(Conflict, match=f"The job ({two}|{making.id}) of this capture is unfinished; cancel it first"):
        records.sessions.delete(first)


def test_proxies_are_of_session_and_nobody_s_reconstruction(jobs: StoreBench, records: TenantRecords) -> None:
    session_id = add(jobs, records, "take")
    job = records.jobs.add(session_id, JobSpec(), stages(1))
    making = ProxyChoices(("cam one", "cam two"))
    plan = (StagePlan("make_proxy", tuple(ChunkPlan(k, {}, UNITS, f"proxy-{k}") for k in range(2)), CODE),)
    proxies = records.jobs.add(session_id, JobSpec(), plan, making=making)
    assert (proxies.making, job_kind(proxies.making)) == (making, "proxies")
    assert records.jobs.page() == [job]
    assert [one.id for one in records.jobs.page(kind="proxies", session_id=session_id)] == [proxies.id]
    assert records.usage().unfinished_jobs == 1
    capture = records.sessions.capture(session_id)
    assert (capture.num_jobs, capture.newest_job) == (1, NewestJob(job.id, JobState.QUEUED))
    assert (capture.proxies, capture.proxies_job) == (frozenset(), NewestJob(proxies.id, JobState.QUEUED))

    # The reconstruction comes first, as long as it has work to do.
    while (claim := jobs.claim()).job_id == job.id:
        jobs.finish(claim)
    assert records.jobs.get(job.id).state == JobState.SUCCEEDED
    assert (claim.stage, claim.making) == ("make_proxy", making)
    assert records.results.proxy(session_id, "proxy-0.mp4") is None
    made = Result("proxy-0.mp4", PROXY_KIND, None, "video/mp4", f"jobs/{proxies.id}/results/proxy-0.mp4", 5, "5" * 64)
    jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 0, results=[made])
    # A proxy is there as soon as it is made.
    assert records.results.proxy(session_id, "proxy-0.mp4") == made
    assert records.sessions.capture(session_id).proxies == {"proxy-0.mp4"}
    assert jobs.store.tenant("other").results.proxy(session_id, "proxy-0.mp4") is None


def test_unfinished_proxies_do_not_keep_session(jobs: StoreBench, records: TenantRecords) -> None:
    session_id = add(jobs, records, "take")
    plan = (StagePlan("make_proxy", (ChunkPlan(0, {}, UNITS, "proxy-0"),), CODE),)
    records.jobs.add(session_id, JobSpec(), plan, making=ProxyChoices(("cam one",)))
    claim = jobs.claim()
    records.sessions.delete(session_id)
    assert not jobs.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 1, 60.0)
    assert not jobs.store.leases.finish(claim.chunk_id, claim.lease_token, "0" * 64, 0)
    assert records.sessions.page() == []


def test_pages_of_search(jobs: StoreBench, records: TenantRecords) -> None:
    ids = [add(jobs, records, f"{kind} {number}") for number in range(3) for kind in ("walk", "run")]
    page = records.sessions.page(limit=2, name="walk")
    assert [one.session.id for one in page] == [ids[4], ids[2]]
    assert [one.session.id for one in records.sessions.page(limit=2, name="walk", after=ids[2])] == [ids[0]]
