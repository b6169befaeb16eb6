"""Event stream of a job: updates, reconnecting, limits, deletion."""

import json
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest

from api.web.errors import ApiError
from api.web.events.changes import JobChanges
from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, problem_of
from tests.cases import slow_but

PATIENCE_S = 20.0


def events_of(answer: httpx2.Response) -> Iterator[dict[str, Any]]:
    """Parse server-sent events: fields up to an empty line; lines that begin with a colon are comments."""
    fields: dict[str, str] = {}
    for line in answer.iter_lines():
        if line == "" and fields:
            yield {**fields, "data": json.loads(fields["data"])}
            fields = {}
        elif line and not line.startswith(":"):
            name, _, value = line.partition(":")
            fields[name] = value.removeprefix(" ")


class Listener(threading.Thread):
    """Receives the events of a job until the stream ends."""

    def __init__(self, live: Live, job_id: str, last_event_id: str | None = None) -> None:
        super().__init__(daemon=True)
        self._url = f"http://{live.address[0]}:{live.address[1]}/v1/jobs/{job_id}/events"
        self._headers = {"Last-Event-ID": last_event_id} if last_event_id else {}
        self.events: list[dict[str, Any]] = []
        self.start()

    def run(self) -> None:
        with (
            httpx2.Client(timeout=PATIENCE_S, trust_env=False) as client,
            client.stream("GET", self._url, headers=self._headers) as answer,
        ):
            assert answer.headers["Content-Type"].startswith("text/event-stream")
            self.events.extend(events_of(answer))

    def wait_for(self, num_events: int) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while len(self.events) < num_events:
            assert time.monotonic() < deadline_s, self.events
            time.sleep(0.02)


def wait_until(condition: Any) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_job_is_followed_to_its_end(live: Live) -> None:
    job_id = live.job_id()
    listener = Listener(live, job_id)
    listener.wait_for(1)
    claim = live.services.store.leases.claim("test", 300.0)
    assert claim is not None
    listener.wait_for(2)
    live.services.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 7, 300.0)
    listener.wait_for(3)
    live.services.store.leases.release(claim.chunk_id, claim.lease_token)
    live.finish(job_id)
    listener.join(PATIENCE_S)
    assert not listener.is_alive()
    told = [event["data"] for event in listener.events]
    assert {event["event"] for event in listener.events} == {"job"}
    states = [job["state"] for job in told]
    assert states[0] == "queued"
    assert states[1:3] == ["running", "running"]
    assert states[-1] == "succeeded"
    progress = [job["progress"] for job in told]
    assert progress == sorted(progress)
    assert 0 < progress[2] < progress[-1] == 1
    numbers = [int(event["id"]) for event in listener.events]
    assert numbers == sorted(numbers)
    assert told[-1] == live.client.get(f"/v1/jobs/{job_id}").json()


def test_stream_of_edited_job_ends_with_its_files(live: Live) -> None:
    job_id, people = live.job_id(), (PersonSpan(1, 0, 60),)
    live.finish(job_id, people=people)
    live.remake(job_id).raise_for_status()
    listener = Listener(live, job_id)
    listener.wait_for(1)
    live.finish(job_id, people=people)
    listener.join(PATIENCE_S)
    told = [event["data"] for event in listener.events]
    assert {job["state"] for job in told} == {"succeeded"}
    assert (told[0]["files_state"], told[-1]["files_state"]) == ("updating", "current")


def test_reconnected_client_gets_missed_events_once(live: Live) -> None:
    job_id = live.job_id()
    first = live.services.store.jobs.changes([job_id])[job_id].event
    waiting = Listener(live, job_id, str(first))
    time.sleep(1.2)
    assert waiting.events == []
    live.finish(job_id)
    waiting.join(PATIENCE_S)
    assert waiting.events[-1]["data"]["state"] == "succeeded"
    late = Listener(live, job_id, str(first))
    late.join(PATIENCE_S)
    assert [event["data"]["state"] for event in late.events] == ["succeeded"]
    last = late.events[-1]["id"]
    done = live.client.get(f"/v1/jobs/{job_id}/events", headers={"Last-Event-ID": last})
    assert (done.status_code, done.content) == (204, b"")


@pytest.mark.parametrize("last_event_id", slow_but(["x"], ["", "x", "-1", "9" * 40, "1; DROP TABLE events"]))
def test_number_that_is_none_is_nothing_seen(live: Live, last_event_id: str) -> None:
    job_id = live.job_id()
    live.finish(job_id)
    listener = Listener(live, job_id, last_event_id)
    listener.join(PATIENCE_S)
    assert [event["data"]["state"] for event in listener.events] == ["succeeded"]


def test_job_that_is_deleted_meanwhile_is_gone(live: Live) -> None:
    job_id = live.job_id()
    listener = Listener(live, job_id)
    listener.wait_for(1)
    live.services.store.jobs.cancel(job_id)
    live.services.store.jobs.delete(job_id)
    listener.join(PATIENCE_S)
    # The end may or may not be sent before the deletion.
    assert listener.events[-1]["event"] == "gone" or listener.events[-1]["data"]["state"] == "canceled"
    problem_of(live.client.get(f"/v1/jobs/{job_id}/events"), 404, "not_found")


@pytest.mark.slow
def test_many_listeners_cost_one_look_time(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    job_id = live.job_id()
    store = live.services.store
    looks: list[int] = []
    look = store.jobs.changes

    def counted(job_ids: Any) -> Any:
        looks.append(len(job_ids))
        return look(job_ids)

    listeners = [Listener(live, job_id) for _ in range(12)]
    for listener in listeners:
        listener.wait_for(1)
    monkeypatch.setattr(store.jobs, "changes", counted)
    started_s = time.monotonic()
    wait_until(lambda: len(looks) >= 4)
    assert len(looks) <= 2 + (time.monotonic() - started_s) / 0.5
    assert set(looks) == {1}
    live.finish(job_id)
    for listener in listeners:
        listener.join(PATIENCE_S)
        assert listener.events[-1]["data"]["state"] == "succeeded"


@pytest.mark.slow
def test_stream_opened_during_poll_gets_event_number(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    look = live.services.store.jobs.changes

    def slowly(job_ids: Any) -> Any:
        found = look(job_ids)
        time.sleep(0.4)
        return found

    monkeypatch.setattr(live.services.store.jobs, "changes", slowly)
    listeners = []
    for _ in range(5):
        listeners.append(Listener(live, live.job_id()))
        time.sleep(0.3)
    for listener in listeners:
        listener.wait_for(1)
        assert listener.events[0]["id"].isdigit()


@pytest.mark.slow
def test_streams_whose_response_has_not_begun_count(live: Live) -> None:
    changes = JobChanges(live.services.store, max_streams=2)
    streams = [changes.follow(changes.open("studio", "job")) for _ in range(2)]
    with pytest.raises(ApiError, match="At most 2 event streams"):
        changes.open("studio", "job")
    changes.open("other", "job")
    # A response that is dropped before it has begun gives its stream back.
    streams.pop()
    changes.open("studio", "job")


def test_closed_streams_end_polling(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    job_id = live.job_id()
    url = f"http://{live.address[0]}:{live.address[1]}/v1/jobs/{job_id}/events"
    with httpx2.Client(timeout=PATIENCE_S, trust_env=False) as client, client.stream("GET", url) as answer:
        assert next(events_of(answer))["data"]["state"] == "queued"
    looks: list[int] = []
    look = live.services.store.jobs.changes

    def counted(job_ids: Any) -> Any:
        looks.append(len(job_ids))
        return look(job_ids)

    monkeypatch.setattr(live.services.store.jobs, "changes", counted)

    def quiet() -> bool:
        before = len(looks)
        time.sleep(1.5)
        return len(looks) == before

    wait_until(quiet)


@pytest.mark.slow
def test_database_that_is_away_for_while_is_waited_for(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    job_id = live.job_id()
    listener = Listener(live, job_id)
    listener.wait_for(1)
    with monkeypatch.context() as away:
        away.setattr(live.services.store.jobs, "changes", lambda ids: 1 / 0)
        time.sleep(1.2)
    live.finish(job_id)
    listener.join(PATIENCE_S)
    assert listener.events[-1]["data"]["state"] == "succeeded"
