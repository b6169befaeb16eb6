"""Idempotency keys: a repeated request is executed once, and gets the first response."""

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import httpx2
import pytest

from api.web.contract.openapi import COMMITTED
from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from tests.api.processes import serving
from tests.api.web.uploads.test_files import PIECE, TUS, Uploader, encoded
from tests.cases import slow_but
from tests.waiting import wait_for
from worker.store.repositories.sessions import Sessions

KEY = {"Idempotency-Key": "01890a5c-7c1e-7a4b-8f00-000000000000"}


@pytest.fixture
def live(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings()) as fresh:
        yield fresh


def again(send: Callable[[], httpx2.Response]) -> httpx2.Response:
    """Send a request twice; check that the responses are equal, and return the response."""
    first, second = send(), send()
    assert first.is_success, first.text
    assert "idempotent-replayed" not in first.headers
    assert second.headers["idempotent-replayed"] == "true"
    assert (first.status_code, first.content) == (second.status_code, second.content)
    for name in ("location", "retry-after", "content-type", "upload-expires"):
        assert first.headers.get(name) == second.headers.get(name)
    return first


def post(live: Live, address: str, headers: dict[str, str]) -> httpx2.Response:
    return live.client.post(address, headers=headers)


def test_every_post_takes_key() -> None:
    contract = json.loads(COMMITTED.read_text(encoding="utf-8"))
    taking = {
        path
        for path, item in contract["paths"].items()
        if any(one["name"] == "idempotency-key" for one in item.get("post", {}).get("parameters", ()))
    }
    # Signing in twice is allowed: it creates nothing that must exist once. The addresses of links are not stored.
    rooms = {"/v1/recordings", "/v1/recordings/{recording_id}/join"}
    without = {"/v1/browser-session", "/v1/jobs/{job_id}/links", *rooms}
    assert taking == {path for path, item in contract["paths"].items() if "post" in item} - without


@pytest.mark.parametrize("path", slow_but(["/v1/jobs"], ["/v1/sessions", "/v1/jobs"]))
def test_form_that_is_cut_otherwise_is_same(live: Live, path: str) -> None:
    spec = [] if path == "/v1/sessions" else [("spec", (None, '{"smoothing": "none"}'))]
    again(lambda: live.client.post(path, files=[*form(), *spec], headers=KEY))  # boundaries are random
    assert len(live.client.get("/v1/sessions").json()["sessions"]) == 1
    assert len(live.client.get("/v1/jobs").json()["jobs"]) == (path == "/v1/jobs")
    assert list(live.settings.spool_dir.iterdir()) == []


@pytest.mark.parametrize(
    "other",
    [form(1), form(3), form(2, b"other"), form(2, calibration=b"[cam_1]"), [*form(), ("manifest", (None, "{}"))]],
)
def test_another_form_under_key_is_refused(live: Live, other: list[tuple[str, Any]]) -> None:
    assert live.client.post("/v1/sessions", files=form(), headers=KEY).status_code == 201
    problem = problem_of(live.client.post("/v1/sessions", files=other, headers=KEY), 422, "idempotency_key_reused")
    assert "new Idempotency-Key" in problem["hint"]
    problem_of(live.client.post("/v1/jobs", files=form(), headers=KEY), 422, "idempotency_key_reused")
    assert len(live.client.get("/v1/sessions").json()["sessions"]) == 1
    assert live.client.post("/v1/sessions", files=form(), headers={"Idempotency-Key": "another"}).status_code == 201


def test_repeated_job_is_created_once(live: Live) -> None:
    session_id = live.session_id()
    job = again(lambda: live.client.post(f"/v1/sessions/{session_id}/jobs", json={}, headers=KEY)).json()
    for act in ("cancel", "retry"):
        address, key = f"/v1/jobs/{job['id']}/{act}", {"Idempotency-Key": act}
        again(partial(post, live, address, key))
    found = live.client.get(f"/v1/jobs/{job['id']}").json()
    assert (found["state"], found["attempt"]) == ("queued", 2)
    assert len(live.client.get("/v1/jobs").json()["jobs"]) == 1


def test_repeated_upload_is_created_once(live: Live) -> None:
    named = TUS | {"Upload-Length": "10", "Upload-Metadata": f"filename {encoded(b'cam_0.mp4')}"}

    def begin(**more: str) -> httpx2.Response:
        return live.client.post("/v1/uploads", headers=named | KEY | more)

    address = again(begin).headers["location"]
    Uploader(live.client).send(address, 0, b"video")
    answer = live.client.post("/v1/uploads", headers=named | KEY | PIECE, content=b"video")
    assert (answer.headers["location"], answer.headers["upload-offset"]) == (address, "5")
    assert len(live.kept()) == 1
    problem_of(begin(**{"Upload-Length": "11"}), 422, "idempotency_key_reused")


def test_sessions_of_uploads_that_are_used_up(live: Live) -> None:
    tus = Uploader(live.client)
    body = {"videos": [tus.upload(b"video", "cam_0.mp4")], "calibration": tus.upload(b"[cam_0]", "rig.toml")}
    session = again(lambda: live.client.post("/v1/sessions", json=body, headers=KEY)).json()
    assert [file["name"] for file in session["files"]] == ["cam_0.mp4", "rig.toml"]
    answer = live.client.post("/v1/sessions", json=body, headers={"Idempotency-Key": "another"})
    problem_of(answer, 422, "invalid_request")


def test_refused_request_may_be_repeated_with_its_key(live: Live) -> None:
    for _ in range(2):
        answer = live.client.post("/v1/sessions", files=form(1, b"WRONG"), headers=KEY)
        problem_of(answer, 422, "invalid_request")
    assert live.client.post("/v1/sessions", files=form(1), headers=KEY).status_code == 201
    missing = "/v1/jobs/01890a5c-7c1e-7a4b-8f00-000000000000/cancel"
    problem_of(live.client.post(missing, headers={"Idempotency-Key": "x"}), 404, "not_found")


def test_while_first_is_answered(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    session_id, entered, go_on = live.session_id(), threading.Event(), threading.Event()
    read = Sessions.get

    def slow(*arguments: Any, **options: Any) -> Any:
        entered.set()
        assert go_on.wait(20)
        return read(*arguments, **options)

    monkeypatch.setattr(Sessions, "get", slow)

    def send() -> httpx2.Response:
        with httpx2.Client(base_url=live.client.base_url, timeout=180) as client:
            return client.post(f"/v1/sessions/{session_id}/jobs", json={}, headers=KEY)

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(send)
        assert entered.wait(20)
        busy = send()
        go_on.set()
        assert problem_of(busy, 409, "idempotency_key_busy")["retryable"]
        assert int(busy.headers["retry-after"]) > 0
        assert send().content == first.result(20).content
    assert len(live.client.get("/v1/jobs").json()["jobs"]) == 1


def test_repeated_request_is_answered_at_quota(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_sessions=1)) as live:
        again(lambda: live.client.post("/v1/sessions", files=form(), headers=KEY))
        answer = live.client.post("/v1/sessions", files=form(), headers={"Idempotency-Key": "another"})
        problem_of(answer, 403, "quota_exceeded")


@pytest.mark.parametrize(("key", "status"), [("x" * 200, 202), ("x" * 201, 422), ("\u00e4", 400), ("a\tb", 400)])
def test_allowed_idempotency_keys(live: Live, key: str, status: int) -> None:
    headers = {"Idempotency-Key": key.encode("latin-1")}
    session_id = live.session_id()
    answer = live.client.post(f"/v1/sessions/{session_id}/jobs", json={}, headers=headers)  # type: ignore[arg-type]
    assert answer.status_code == status


@pytest.mark.slow
def test_key_whose_request_was_killed_is_free_within_its_lease(make_settings: Callable[..., Settings]) -> None:
    """The API process is killed during the check of the files, and started again on the same folder."""
    settings, lease_s = make_settings(), 60.0
    answers: list[httpx2.Response] = []

    def send(client: httpx2.Client) -> bool:
        with contextlib.suppress(httpx2.TransportError):
            answers.append(client.post("/v1/sessions", files=form(1, b"HANG!"), headers=KEY))
        return bool(answers) and answers[-1].status_code != 409

    with ThreadPoolExecutor(1) as pool, serving(settings, IDEMPOTENCY_LEASE_S=str(lease_s)) as (client, process):
        sent = pool.submit(send, client)
        wait_for(lambda: any("preflight.py" in " ".join(child.cmdline()) for child in process.children()))
        process.kill()
        sent.result()
    with serving(settings, IDEMPOTENCY_LEASE_S=str(lease_s), PREFLIGHT_TIMEOUT_S="1") as (client, _):
        wait_for(lambda: send(client))
    busy, checked = answers[0], answers[-1]
    assert problem_of(busy, 409, "idempotency_key_busy")["retryable"]
    assert problem_of(checked, 422, "invalid_request")["errors"][0]["code"] == "preflight_timeout"


@pytest.mark.slow
def test_key_stays_taken_as_long_as_its_request_is_at_work(make_settings: Callable[..., Settings]) -> None:
    """The check of the files takes several times the lease."""
    with (
        running(make_settings(idempotency_lease_s=0.6, preflight_timeout_s=5.0)) as live,
        ThreadPoolExecutor(1) as pool,
    ):
        parts = form(1, b"HANG!")
        first = pool.submit(live.client.post, "/v1/sessions", files=parts, headers=KEY)
        time.sleep(0.5)
        answers = []
        while not first.done():
            answers.append(live.client.post("/v1/sessions", files=parts, headers=KEY))
            time.sleep(0.3)
        assert len(answers) > 5
        for answer in answers[:-1]:  # the last response may have come after the end of the first request
            assert problem_of(answer, 409, "idempotency_key_busy")["retryable"]
        assert first.result().status_code == 422
