"""Messages of jobs' ends: signed, sent again until they are taken, and given up in the end."""

import itertools
import json
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from standardwebhooks import Webhook
from standardwebhooks.webhooks import WebhookVerificationError

from api.web.jobs.schemas import JobEnded
from pipeline.core.options.edits import Rename
from tests.cases import slow_but
from tests.worker.conftest import RunnerBench
from tests.worker.run.webhooks.conftest import HOUR_S, Receiver, deliver, end_job, make_due
from worker.run.planning import plan_job
from worker.run.webhooks import sender as webhooks
from worker.run.webhooks.sender import Sender
from worker.store.model.job_records import Delivery
from worker.store.repositories.webhooks import MAX_TRIES
from worker.store.spec import JobSpec


def test_end_of_job_arrives_signed(bench: RunnerBench, receiver: Receiver) -> None:
    key = bench.store.webhook_secrets.rotate("default", HOUR_S)
    job = end_job(bench, receiver.url)
    assert deliver(bench) == 1
    ((headers, body),) = receiver.received
    found = Webhook(key).verify(body, headers)
    JobEnded.model_validate(found)
    assert found.pop("timestamp").endswith("Z")
    data = {"id": job.id, "session_id": job.session_id, "state": "succeeded", "files_state": "current", "attempt": 1}
    assert found == {"type": "job.succeeded", "data": data | {"warnings": []}}
    assert (headers["content-type"], receiver.paths) == ("application/json", ["/hook?x=1"])
    with pytest.raises(WebhookVerificationError):
        Webhook(key).verify(body + b" ", headers)
    assert deliver(bench) == 0
    assert bench.store.webhooks.pending() == []


def test_job_without_callback_url_sends_nothing(bench: RunnerBench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    assert bench.store.webhooks.pending() == []


@pytest.mark.parametrize(("end", "state"), [("cancel", "canceled"), ("fail", "failed")])
def test_every_end_sends_message(bench: RunnerBench, receiver: Receiver, end: str, state: str) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    spec = JobSpec(callback_url=receiver.url)
    stages = plan_job(replace(bench.session, chunk_frames=1000), spec)
    job = bench.store.jobs.add(bench.session.id, spec, stages, retention_s=-1.0)
    if end == "cancel":
        bench.store.jobs.cancel(job.id)
    else:
        bench.stages["detect"] = lambda work: 1 // 0  # type: ignore[assignment, return-value]
        while bench.store.jobs.get(job.id).finished_at is None:
            bench.runner().work(60.0)
    bench.store.removals.expire_jobs()
    deliver(bench)
    said = [json.loads(body) for _, body in receiver.received]
    assert {one["data"]["state"] for one in said} == {state, "expired"}
    assert {one["type"] for one in said} == {f"job.{state}", "job.expired"}


def test_files_of_edits_send_messages_of_their_own(bench: RunnerBench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    job = end_job(bench, receiver.url)
    bench.edit(job.id, Rename(person=1, name="Anna"))
    bench.runner().work(60.0)
    bench.edit(job.id)
    bench.store.jobs.cancel(job.id)
    deliver(bench)
    said = [json.loads(body) for _, body in receiver.received]
    assert {(one["type"], one["data"]["state"], one["data"]["files_state"]) for one in said} == {
        ("job.succeeded", "succeeded", "current"),
        ("job.files_current", "succeeded", "current"),
        ("job.files_failed", "succeeded", "failed"),
    }


@pytest.mark.parametrize("status", slow_but([301, 500], [301, 302, 307, 400, 404, 429, 500, 503]))
def test_refused_message_is_sent_again_with_same_id(bench: RunnerBench, receiver: Receiver, status: int) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [status]
    deliver(bench)
    (left,) = bench.store.webhooks.pending()
    assert (left.tries, left.problem) == (1, f"It was answered with {status}.")
    assert deliver(bench) == 0  # not due yet
    make_due(bench)
    assert deliver(bench) == 1
    assert bench.store.webhooks.pending() == []
    assert len({headers["webhook-id"] for headers, _ in receiver.received}) == 1
    assert receiver.paths == ["/hook?x=1"] * 2  # redirects are not followed


def test_answer_410_ends_attempts(bench: RunnerBench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [410]
    deliver(bench)
    assert bench.store.webhooks.pending() == []


def test_attempts_end_after_about_day(bench: RunnerBench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [500] * 100
    waits_s: list[float] = []
    while bench.store.webhooks.pending():
        assert len(waits_s) < 50
        make_due(bench)
        deliver(bench)
        if left := bench.store.webhooks.pending():
            waits_s.append(left[0].due_at.timestamp() - time.time())
    assert len(receiver.received) == len(waits_s) + 1
    assert all(later > earlier for earlier, later in itertools.pairwise(waits_s))
    assert 20 * HOUR_S < sum(waits_s) < 30 * HOUR_S


def test_sender_killed_before_recording_sends_message_again(bench: RunnerBench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    assert len(bench.store.webhooks.claim(10, -1.0)) == 1  # claimed, and never recorded
    assert deliver(bench) == 1
    assert len(receiver.received) == 1


def test_two_senders_share_work(bench: RunnerBench, receiver: Receiver) -> None:
    end_job(bench, receiver.url)
    assert len(bench.store.webhooks.claim(10, 60.0)) == 1
    assert bench.store.webhooks.claim(10, 60.0) == []


def test_after_rotation_both_secrets_sign_for_while(bench: RunnerBench, receiver: Receiver) -> None:
    old = bench.store.webhook_secrets.rotate("default", HOUR_S)
    other = bench.store.webhook_secrets.rotate("other", HOUR_S)
    new = bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    deliver(bench)
    ((headers, body),) = receiver.received
    for key in (old, new):
        Webhook(key).verify(body, headers)
    with pytest.raises(WebhookVerificationError):
        Webhook(other).verify(body, headers)
    newest = bench.store.webhook_secrets.rotate("default", -1.0)
    assert [one.secret for one in bench.store.webhook_secrets.valid("default")] == [newest, old]
    assert newest not in repr(bench.store.webhook_secrets.valid("default"))


def test_failing_store_does_not_end_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing:
        looks = 0

        def claim(self, *_: object) -> list[Delivery]:
            self.looks += 1
            if self.looks == 3:
                raise KeyboardInterrupt
            raise RuntimeError

    monkeypatch.setattr(webhooks, "_LOOK_S", 0.0)
    store = SimpleNamespace(webhooks=Failing())
    with pytest.raises(KeyboardInterrupt):
        webhooks.deliver_forever(store, Sender(allow_private=False))  # type: ignore[arg-type]


class Exploding(Sender):
    """Sender that raises an unforeseen exception."""

    def send(self, delivery: Delivery, secrets: object) -> str | None:
        raise LookupError(delivery.url)


def test_unforeseen_exception_counts_as_attempt(bench: RunnerBench) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, "https://hook.example/")
    assert deliver(bench, Exploding(allow_private=False)) == 1
    (left,) = bench.store.webhooks.pending()
    assert (left.tries, left.problem) == (1, "The attempt failed; the reaper's log says why.")
    for _ in range(MAX_TRIES - 1):
        make_due(bench)
        assert deliver(bench, Exploding(allow_private=False)) == 1
    assert bench.store.webhooks.pending() == []


def test_unrecorded_attempts_have_end(bench: RunnerBench, receiver: Receiver) -> None:
    end_job(bench, receiver.url)
    for _ in range(MAX_TRIES):
        assert len(bench.store.webhooks.claim(10, -1.0)) == 1  # the sender is killed
    assert deliver(bench) == 1
    assert bench.store.webhooks.pending() == []
    assert receiver.received == []
