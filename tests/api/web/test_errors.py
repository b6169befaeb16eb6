"""Problems: statuses, codes, pointers and sentences of refused requests."""

import json
import sqlite3
from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy.exc import OperationalError

from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from worker.store.repositories.jobs import Jobs

UNKNOWN = "0192d7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10"


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/nowhere", 404, "not_found"),
        ("GET", "/portal/../../etc/passwd", 404, "not_found"),
        ("PUT", "/v1/jobs", 405, "method_not_allowed"),
        ("TRACE", "/healthz", 405, "method_not_allowed"),
        ("GET", f"/v1/jobs/{UNKNOWN}", 404, "not_found"),
        ("GET", "/v1/jobs/no-id", 404, "not_found"),
        ("GET", "/v1/jobs/%00", 404, "not_found"),
        ("GET", f"/v1/sessions/{UNKNOWN}", 404, "not_found"),
        ("DELETE", f"/v1/sessions/{UNKNOWN}", 404, "not_found"),
        ("DELETE", f"/v1/jobs/{UNKNOWN}", 404, "not_found"),
        ("POST", f"/v1/jobs/{UNKNOWN}/cancel", 404, "not_found"),
        ("POST", f"/v1/jobs/{UNKNOWN}/retry", 404, "not_found"),
        ("POST", f"/v1/sessions/{UNKNOWN}/jobs", 404, "not_found"),
        ("GET", f"/v1/jobs/{UNKNOWN}/results", 404, "not_found"),
        ("GET", f"/v1/jobs/{UNKNOWN}/results/person-1.bvh", 404, "not_found"),
        ("GET", f"/v1/jobs/{UNKNOWN}/results.zip", 404, "not_found"),
        ("GET", "/v1/jobs?limit=0", 422, "invalid_request"),
        ("GET", "/v1/jobs?state=asleep", 422, "invalid_request"),
        ("GET", "/v1/sessions?cursor=1", 422, "invalid_request"),
        ("POST", "/v1/sessions", 415, "unsupported_media_type"),
        ("POST", "/v1/jobs", 415, "unsupported_media_type"),
    ],
)
def test_every_refusal_is_problem(live: Live, method: str, path: str, status: int, code: str) -> None:
    problem_of(live.client.request(method, path), status, code)


def test_refused_method_says_which_are_allowed(live: Live) -> None:
    assert live.client.put("/healthz").headers["allow"] == "GET, HEAD"
    assert live.client.put("/v1/jobs").headers["allow"] == "GET, HEAD, POST"
    assert live.client.put(f"/v1/jobs/{UNKNOWN}").headers["allow"] == "GET, HEAD, DELETE"
    assert live.client.put(f"/v1/uploads/{UNKNOWN}").headers["allow"] == "GET, HEAD, PATCH, DELETE"


def test_pointers_lead_to_parameters(live: Live) -> None:
    problem = problem_of(live.client.get("/v1/jobs?limit=1000&state=asleep"), 422, "invalid_request")
    assert {(item["pointer"], item["code"], item["message"]) for item in problem["errors"]} == {
        ("/query/limit", "out_of_range", "The parameter limit must be a whole number from 1 to 200."),
        (
            "/query/state",
            "value_not_allowed",
            "The parameter state must be one of queued, running, canceling, succeeded, failed, canceled, expired.",
        ),
    }
    assert problem["detail"] == "2 things are wrong with the request."


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        (b"{", 400, "malformed_json"),
        (b'"\xff"', 400, "malformed_request"),
        (b"[" * 900, 400, "malformed_json"),
        (b"[]", 422, "invalid_request"),
        (b"3", 422, "invalid_request"),
        (b'{"method": 3}', 422, "invalid_request"),
        (b'{"method": "guessing"}', 422, "invalid_request"),
        (b'{"colour": "red"}', 422, "invalid_request"),
        (b'{"\\ud800": 1}', 422, "invalid_request"),
        (b'{"a/b~": 1}', 422, "invalid_request"),
        (b'"' + b"x" * 1_000 + b'"', 413, "content_too_large"),
    ],
)
def test_hostile_json(live: Live, body: bytes, status: int, code: str) -> None:
    path = f"/v1/sessions/{UNKNOWN}/jobs"
    answer = live.client.post(path, content=body, headers={"Content-Type": "application/json"})
    problem_of(answer, status, code)


def test_pointer_escapes(live: Live) -> None:
    answer = live.client.post(f"/v1/sessions/{UNKNOWN}/jobs", json={"a/b~": 1})
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (item["pointer"], item["code"]) == ("/a~1b~0", "unknown_field")


def test_huge_json_is_refused_before_it_is_read(live: Live) -> None:
    def endless() -> Any:
        for _ in range(100):
            yield b" " * 100_000

    headers = {"Content-Type": "application/json"}
    answer = live.client.post(f"/v1/sessions/{UNKNOWN}/jobs", content=endless(), headers=headers)
    problem_of(answer, 413, "content_too_large")


def test_json_of_another_type_is_not_read(live: Live) -> None:
    answer = live.client.post(
        f"/v1/sessions/{UNKNOWN}/jobs", content=b'{"method": "tracking"}', headers={"Content-Type": "text/plain"}
    )
    problem = problem_of(answer, 415, "unsupported_media_type")
    assert problem["detail"] == "This address accepts application/json."


def test_failure_of_service_says_nothing_of_its_insides(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("/srv/secret/path is gone")

    monkeypatch.setattr(Jobs, "page", fail)
    answer = live.client.get("/v1/jobs")
    problem = problem_of(answer, 500, "internal_error")
    assert problem["retryable"] is True
    assert "secret" not in answer.text
    assert "RuntimeError" not in json.dumps(dict(answer.headers))


def test_database_away_is_503(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OperationalError("SELECT secret", {}, sqlite3.OperationalError("unable to open database file"))

    monkeypatch.setattr(Jobs, "page", fail)
    answer = live.client.get("/v1/jobs")
    problem_of(answer, 503, "database_unavailable")
    assert answer.headers["retry-after"] == "5"
    assert "secret" not in answer.text


@pytest.mark.slow
def test_thousands_of_unknown_fields_are_answered_by_dozens(make_settings: Callable[..., Settings]) -> None:
    fields = {f"field {number} {'x' * (number == 7 and 60_000)}": number for number in range(100_000)}
    with running(make_settings(max_json_bytes=8_000_000, max_session_bytes=9_000_000)) as live:
        for answer in (
            live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, json.dumps(fields)))]),
            live.client.post("/v1/sessions", json=fields),
            live.client.post(f"/v1/sessions/{live.session_id()}/jobs", json=fields),
        ):
            problem = problem_of(answer, 422, "invalid_request")
            assert 20 < len(problem["errors"]) < 100
            assert problem["errors"][-1]["code"] == "more_problems"
            assert problem["errors"][-1]["message"].startswith("99,9")
            assert len(answer.content) < 100_000


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1" + "0" * 5000, "1e400", "-1e400", "NaN", "Infinity"])
@pytest.mark.parametrize("field", ["frame_rate_hz", "metadata", "cameras"])
def test_numbers_that_are_none(live: Live, field: str, number: str) -> None:
    values = {"metadata": f'{{"a": {number}}}', "cameras": f'[{{"name": "a", "offset_s": {number}}}]'}
    manifest = f'{{"{field}": {values.get(field, number)}}}'
    answer = live.client.post("/v1/sessions", files=[*form(), ("manifest", (None, manifest))])
    whole = field == "metadata" and number == "1" + "0" * 400  # valid JSON, which the response repeats
    assert answer.status_code == (201 if whole else 413 if len(number) > 1000 else 422), answer.text
    spec = f'{{"frame_range": [0, {number}]}}'
    headers = {"Content-Type": "application/json"}
    answer = live.client.post(f"/v1/sessions/{live.session_id()}/jobs", content=spec, headers=headers)
    assert 400 <= answer.status_code < 500, answer.text
