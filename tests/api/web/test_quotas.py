"""Quotas and the rate limit over HTTP: at the limit, one over it, and after it resets."""

import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from worker.store.model.rights import Scope


def add_session(live: Live) -> str:
    return str(live.post_session().raise_for_status().json()["id"])


def test_sessions(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_sessions=2)) as live:
        first = add_session(live)
        add_session(live)
        kept = live.kept()
        for path in ("/v1/sessions", "/v1/jobs"):
            problem = problem_of(live.client.post(path, files=form()), 403, "quota_exceeded")
            assert problem["hint"] == "Delete captures that are no longer needed."
        assert live.kept() == kept
        assert live.client.get("/v1/caller").json()["quotas"]["sessions"] == {"used": 2, "limit": 2}
        live.client.delete(f"/v1/sessions/{first}")
        add_session(live)


def test_bytes_are_refused_before_they_are_sent(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_bytes=100_000)) as live:
        assert live.client.post("/v1/sessions", files=form(1, b"v" * 60_000)).status_code == 201
        # The body is not a form; it is refused before it is read.
        headers = {"Content-Type": "multipart/form-data; boundary=x"}
        answer = live.client.post("/v1/sessions", content=b"v" * 60_000, headers=headers)
        problem_of(answer, 403, "quota_exceeded")
        # Without an announced length the size is known only at the end.
        sized = live.client.build_request("POST", "/v1/sessions", files=form(1, b"v" * 50_000))
        answer = live.client.post(
            "/v1/sessions", content=iter([sized.read()]), headers={"Content-Type": sized.headers["content-type"]}
        )
        problem_of(answer, 403, "quota_exceeded")
        assert len(live.client.get("/v1/sessions").json()["sessions"]) == 1


def test_unfinished_jobs(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_unfinished_jobs=1)) as live:
        session_id = add_session(live)
        job_id = live.client.post(f"/v1/sessions/{session_id}/jobs").raise_for_status().json()["id"]
        answer = live.client.post(f"/v1/sessions/{session_id}/jobs")
        assert problem_of(answer, 429, "quota_exceeded")["retryable"]
        assert answer.headers["retry-after"] == "30"
        answer = live.client.post("/v1/jobs", files=form())
        problem_of(answer, 429, "quota_exceeded")
        assert (
            len(live.client.get("/v1/sessions").json()["sessions"]) == 1
        )  # neither the session nor the job was created
        live.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        assert live.client.post(f"/v1/sessions/{session_id}/jobs").status_code == 202
        problem_of(live.client.post(f"/v1/jobs/{job_id}/retry"), 429, "quota_exceeded")


def test_requests_minute(make_settings: Callable[..., Settings], monkeypatch: pytest.MonkeyPatch) -> None:
    with running(make_settings(max_requests_per_minute=5)) as live:
        secrets = [live.services.store.keys.add(tenant, "x", {Scope.READ})[1] for tenant in ("mine", "mine", "theirs")]
        first, second, theirs = ({"Authorization": f"Bearer {secret}"} for secret in secrets)
        for number in range(5):
            headers = first if number % 2 else second  # keys of one tenant count together
            assert live.client.get("/v1/jobs", headers=headers).status_code == 200
        answer = live.client.get("/v1/jobs", headers=first)
        assert problem_of(answer, 429, "too_many_requests")["retryable"]
        assert 1 <= int(answer.headers["retry-after"]) <= 60
        assert live.client.get("/v1/jobs", headers=theirs).status_code == 200
        problem_of(live.client.post("/v1/browser-session", json={"key": secrets[0]}), 429, "too_many_requests")
        assert live.client.get("/healthz").status_code == 200
        monkeypatch.setattr("api.web.http.rates.time", SimpleNamespace(monotonic=lambda: time.monotonic() + 61.0))
        assert live.client.get("/v1/jobs", headers=first).status_code == 200
