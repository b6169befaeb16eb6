"""Sessions as captures: searched, renamed, with their jobs."""

import pytest

from pipeline.calibration_choices import CalibrationChoices
from tests.worker.jobs.conftest import PREFLIGHT, Bench, stages
from worker.jobs.errors import Conflict
from worker.jobs.model import JobState, NewestJob
from worker.jobs.spec import JobSpec
from worker.jobs.tenant_records import TenantRecords


@pytest.fixture
def records(jobs: Bench) -> TenantRecords:
    return jobs.store.of("studio")


def add(jobs: Bench, records: TenantRecords, name: str) -> str:
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
def test_search_by_name(jobs: Bench, records: TenantRecords, text: str, found: list[str]) -> None:
    for name in ("Handshake, take 3", "take_2", "STRASSE 5", "École", "100% done"):
        add(jobs, records, name)
    add(jobs, jobs.store.of("other"), "Handshake of others, take 100%_\\ École STRASSE")
    assert names(records, text) == found


def test_a_session_with_another_name_is_found_by_that_alone(jobs: Bench, records: TenantRecords) -> None:
    session_id = add(jobs, records, "Walk")
    job = records.jobs.add(session_id, JobSpec(), stages(1))
    assert records.sessions.rename(session_id, "Gehen ß").session.name == "Gehen ß"
    assert (names(records, "walk"), names(records, "gehen SS")) == ([], ["Gehen ß"])
    assert records.jobs.get(job.id).session_name == "Gehen ß"


def test_captures_have_their_newest_reconstruction(jobs: Bench, records: TenantRecords) -> None:
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
    with pytest.raises(Conflict, match=f"The job ({two}|{making.id}) of this session is unfinished; cancel it first"):
        records.sessions.delete(first)


def test_pages_of_a_search(jobs: Bench, records: TenantRecords) -> None:
    ids = [add(jobs, records, f"{kind} {number}") for number in range(3) for kind in ("walk", "run")]
    page = records.sessions.page(limit=2, name="walk")
    assert [one.session.id for one in page] == [ids[4], ids[2]]
    assert [one.session.id for one in records.sessions.page(limit=2, name="walk", after=ids[2])] == [ids[0]]
