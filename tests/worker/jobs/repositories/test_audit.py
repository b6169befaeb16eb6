from tests.worker.jobs.conftest import Bench, stages
from worker.jobs.database.quotas import Quotas
from worker.jobs.model import Actor, Problem, Scope
from worker.jobs.spec import JobSpec

PREFLIGHT = {"cameras": [{"name": "cam"}], "timebase": {"num_frames": 60, "frame_rate_hz": 25.0}, "warnings": []}
ACTOR = Actor("key", "request")


def test_what_is_done_is_noted_with_who_did_it(jobs: Bench) -> None:
    mine = jobs.store.of("mine", Quotas(), ACTOR)
    session_id = mine.create_session("take", [], PREFLIGHT, jobs.store.announce_session()).id
    job_id = mine.create_job(session_id, JobSpec(), stages(1)).id
    claim = jobs.claim()
    jobs.store.fail(claim.chunk_id, claim.lease_token, Problem("broken", "It is broken."))
    mine.retry(job_id, stages(1))
    mine.cancel(job_id)
    mine.delete_job(job_id)
    mine.delete_session(session_id)
    deeds = jobs.store.deeds("mine")
    assert [(deed.act, deed.subject) for deed in reversed(deeds)] == [
        ("session-created", session_id),
        ("job-created", job_id),
        ("job-retried", job_id),
        ("job-canceled", job_id),
        ("job-deleted", job_id),
        ("session-deleted", session_id),
    ]
    assert {(deed.tenant, deed.actor) for deed in deeds} == {("mine", ACTOR)}
    assert [deed.done_at for deed in deeds] == sorted((deed.done_at for deed in deeds), reverse=True)


def test_what_is_refused_was_not_done(jobs: Bench) -> None:
    job = jobs.queue()
    before = jobs.store.deeds()
    jobs.claim()
    jobs.store.cancel(job.id)
    jobs.store.cancel(job.id)  # once is enough
    assert [deed.act for deed in jobs.store.deeds()][: -len(before)] == ["job-canceled"]


def test_keys_are_noted_too(jobs: Bench) -> None:
    key, _ = jobs.store.create_key("studio", "portal", {Scope.READ})
    jobs.store.open_browser_session(key, 60.0, "request")
    jobs.store.revoke_key(key.id)
    jobs.store.revoke_key(key.id)
    deeds = jobs.store.deeds("studio")
    assert [(deed.act, deed.subject, deed.actor) for deed in deeds] == [
        ("key-revoked", key.id, Actor()),
        ("browser-let-in", key.id, Actor(key.id, "request")),
        ("key-created", key.id, Actor()),
    ]


def test_the_last_ones_come_first(jobs: Bench) -> None:
    for _ in range(5):
        jobs.queue()
    assert len(jobs.store.deeds(limit=3)) == 3
    assert jobs.store.deeds(limit=1)[0].subject == jobs.store.jobs(limit=1)[0].id
    assert jobs.store.deeds("nobody") == []
