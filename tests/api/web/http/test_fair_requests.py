"""Routes take turns: a tenant that keeps all its requests at work leaves threads to others."""

import re
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import httpx2
import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from tests.waiting import wait_for
from worker.store.model.rights import Scope

NUM_REQUESTS = 60
"""More than the process has threads."""
PUBLIC = {"describeUploads", "openBrowserSession", "closeBrowserSession", "getHealth", "getReadiness"}
"""Routes that ask for no key."""
BODIES = ("", "FromFiles", "FromUploads")
RECORDS = ("Session", "SessionAndJob", "Calibration", "Character")
WAITING = {
    *(f"create{record}{body}" for record in RECORDS for body in BODIES),
    "streamJobEvents", "changeCharacter", "createTakeSession",
    "createTakeCalibration", "createUpload", "continueUpload", "deleteUpload", "getCalibrationFile", "planRig",
}  # fmt: skip
"""Routes that wait for their clients or for the check of files: their work has shares of its own."""


class Gate:
    """Stands before a function of the service, and lets no call pass until it is opened."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function, self._opened = function, threading.Event()
        self.num_waiting = self.most_waiting = 0
        self._lock = threading.Lock()

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        with self._lock:
            self.num_waiting += 1
            self.most_waiting = max(self.most_waiting, self.num_waiting)
        assert self._opened.wait(60)
        with self._lock:
            self.num_waiting -= 1
        return self._function(*arguments, **options)

    def open(self) -> None:
        self._opened.set()


@pytest.fixture(scope="module")
def live(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings()) as live:
        yield live


def client_of(live: Live, tenant: str) -> httpx2.Client:
    _, secret = live.services.store.keys.add(tenant, "key", frozenset(Scope))
    return httpx2.Client(base_url=live.client.base_url, headers={"Authorization": f"Bearer {secret}"}, timeout=180)


def test_tenant_at_work_leaves_threads_to_others(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    with client_of(live, "costly") as costly, client_of(live, "light") as light:
        session = costly.post("/v1/sessions", files=form(2)).json()["id"]
        job_id = costly.post(f"/v1/sessions/{session}/jobs", json={}).json()["id"]
        live.finish(job_id)
        gate = Gate(live.services.artifacts.open)
        monkeypatch.setattr(live.services.artifacts, "open", gate)
        with ThreadPoolExecutor(NUM_REQUESTS) as pool:
            path = f"/v1/jobs/{job_id}/results/person-1.bvh"
            sent = [pool.submit(costly.get, path) for _ in range(NUM_REQUESTS)]
            try:
                wait_for(lambda: gate.num_waiting == 4)
                for _ in range(5):
                    assert light.get("/v1/jobs").json()["jobs"] == []
                assert gate.most_waiting == 4
                assert not any(request.done() for request in sent)
            finally:
                gate.open()
            assert {request.result().status_code for request in sent} == {200}


def test_requests_that_wait_are_limited(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    with client_of(live, "many") as many:
        many.get("/v1/jobs")
        monkeypatch.setattr(live.services.turns, "_limits", replace(live.services.turns._limits, max_waiting=3))
        gate = Gate(live.services.store.tenant)
        monkeypatch.setattr(live.services.store, "tenant", gate)
        with ThreadPoolExecutor(20) as pool:
            sent = [pool.submit(many.get, "/v1/caller") for _ in range(20)]
            try:
                wait_for(lambda: sum(request.done() for request in sent) == 20 - 4 - 3)
            finally:
                gate.open()
            refused = [request.result() for request in sent if request.result().status_code != 200]
    assert len(refused) == 13
    for answer in refused:
        problem_of(answer, 429, "too_many_at_once")
        assert answer.headers["retry-after"]


def test_every_route_with_thread_takes_turn(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[str] = []
    turn = live.services.turns.turn
    monkeypatch.setattr(live.services.turns, "turn", lambda owner: taken.append(owner) or turn(owner))  # type: ignore[func-returns-value]
    without = set()
    with client_of(live, "visitor") as visitor:
        for path, methods in live.client.get("/openapi.json").json()["paths"].items():
            for method, operation in methods.items():
                num_taken = len(taken)
                address = re.sub(r"{number}", "0", path)
                address = re.sub(r"{\w+}", "01a210fd-210b-7606-995c-aa5aa4aa87d8", address)
                answer = visitor.request(method, address, headers={"Tus-Resumable": "1.0.0"})
                assert answer.status_code not in {401, 405, 500}, (method, path)
                if len(taken) == num_taken:
                    without.add(operation["operationId"])
    assert without == PUBLIC | WAITING
