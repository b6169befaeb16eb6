from pipeline.core.problems.code_group import Code
from tests.worker.store.conftest import PREFLIGHT, StoreBench, stages
from worker.store.database.quotas import Quotas
from worker.store.model.job_records import JobProblem
from worker.store.model.rights import Actor, Scope
from worker.store.spec import JobSpec

ACTOR = Actor("key", "request")


def test_action_is_recorded_with_actor(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(), ACTOR)
    session_id = mine.sessions.add("take", [], PREFLIGHT, jobs.store.sessions.reserve_id()).id
    for name in ("Handshake", "Handshake"):  # the second time it is no change
        mine.sessions.rename(session_id, name)
    job_id = mine.jobs.add(session_id, JobSpec(), stages(1)).id
    claim = jobs.claim()
    jobs.store.leases.fail(claim.chunk_id, claim.lease_token, JobProblem(Code("broken"), "It is broken."))
    mine.jobs.retry(job_id, stages(1))
    mine.jobs.cancel(job_id)
    mine.jobs.delete(job_id)
    mine.sessions.delete(session_id)
    events = jobs.store.audit.events("mine")
    assert [(event.act, event.subject) for event in reversed(events)] == [
        ("session-created", session_id),
        ("session-renamed", session_id),
        ("job-created", job_id),
        ("job-retried", job_id),
        ("job-canceled", job_id),
        ("job-deleted", job_id),
        ("session-deleted", session_id),
    ]
    assert {(event.tenant, Actor(event.key_id, event.request_id)) for event in events} == {("mine", ACTOR)}
    assert [event.done_at for event in events] == sorted((event.done_at for event in events), reverse=True)


def test_calibration_rename_is_recorded(jobs: StoreBench) -> None:
    mine = jobs.store.tenant("mine", Quotas(), ACTOR)
    made = mine.calibrations.add("Studio", {}, '{"cameras": []}').id
    for name in ("Studio B", "Studio B"):  # the second time it is no change
        assert mine.calibrations.rename(made, name).name == "Studio B"
    acts = [event.act for event in jobs.store.audit.events("mine") if event.subject == made]
    assert acts == ["calibration-renamed", "calibration-created"]


def test_action_refused_is_not_recorded(jobs: StoreBench) -> None:
    job = jobs.queue()
    before = jobs.store.audit.events()
    jobs.claim()
    jobs.store.jobs.cancel(job.id)
    jobs.store.jobs.cancel(job.id)  # once is enough
    assert [event.act for event in jobs.store.audit.events()][: -len(before)] == ["job-canceled"]


def test_keys_are_noted_too(jobs: StoreBench) -> None:
    key, _ = jobs.store.keys.add("studio", "portal", {Scope.READ})
    jobs.store.browser_sessions.open(key, 60.0, "request")
    jobs.store.keys.revoke(key.id)
    jobs.store.keys.revoke(key.id)
    events = jobs.store.audit.events("studio")
    assert [(event.act, event.subject, Actor(event.key_id, event.request_id)) for event in events] == [
        ("key-revoked", key.id, Actor()),
        ("browser-let-in", key.id, Actor(key.id, "request")),
        ("key-created", key.id, Actor()),
    ]


def test_events_newest_come_first(jobs: StoreBench) -> None:
    for _ in range(5):
        jobs.queue()
    assert len(jobs.store.audit.events(limit=3)) == 3
    assert jobs.store.audit.events(limit=1)[0].subject == jobs.store.jobs.page(limit=1)[0].id
    assert jobs.store.audit.events("nobody") == []
