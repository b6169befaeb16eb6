"""Conventions of all addresses: HEAD, entity tags, caching, rate limit headers, and headers for other origins."""

from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import httpx2
import pytest
from sse_starlette import ServerSentEvent

from api.web.events.routes import _events
from api.web.results import _content
from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from worker.store.model.rights import Scope

UNKNOWN = "0192d7a5-7c1e-7b2a-8f3e-6d5c4b3a2f10"
# Headers that differ in every response.
OWN = {"date", "x-request-id"}


@pytest.fixture
def addresses(live: Live) -> list[str]:
    """Addresses of every kind that answer GET: pages, health, the contract, records, lists, files."""
    job_id = live.job_id()
    live.finish(job_id)
    session_id = live.client.get(f"/v1/jobs/{job_id}").json()["session_id"]
    job, session = f"/v1/jobs/{job_id}", f"/v1/sessions/{session_id}"
    return [
        "/", "/docs", "/portal/main.js", "/openapi.json", "/healthz", "/nowhere", "/v1/caller",
        "/v1/jobs", "/v1/jobs?limit=0", "/v1/sessions", job, session, f"{session}/jobs", f"{job}/attempts",
        f"{job}/results", f"{job}/results/person-1.bvh", f"{job}/results/person-9.bvh",
    ]  # fmt: skip


def test_head_has_headers_of_get_and_no_body(live: Live, addresses: list[str]) -> None:
    for address in addresses:
        got, headed = live.client.get(address), live.client.head(address)
        assert (headed.status_code, headed.content) == (got.status_code, b""), address
        assert {name: value for name, value in headed.headers.items() if name not in OWN} == {
            name: value for name, value in got.headers.items() if name not in OWN
        }, address
        assert int(headed.headers["content-length"]) > 0


def test_head_begins_no_stream(live: Live, addresses: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []

    def content(*arguments: Any) -> Iterator[bytes]:
        begun.append("content")
        yield from _content(*arguments)

    async def events(*arguments: Any) -> AsyncIterator[ServerSentEvent]:
        begun.append("events")
        async for event in _events(*arguments):
            yield event

    monkeypatch.setattr("api.web.results._content", content)
    monkeypatch.setattr("api.web.events.routes._events", events)
    streams = [(f"{addresses[10]}/results.zip", "application/zip"), (f"{addresses[10]}/events", "text/event-stream")]
    for address, media_type in streams:
        headed = live.client.head(address)
        assert (headed.status_code, headed.content) == (200, b"")
        assert headed.headers["content-type"].startswith(media_type)
    # The connection stays usable, and HEAD does not wait for the end of the stream of an unfinished job.
    assert live.client.head(f"/v1/jobs/{live.job_id()}/events").status_code == 200
    assert live.client.get("/healthz").status_code == 200
    assert begun == []
    for address, _ in streams:
        live.client.get(address).raise_for_status()
    assert begun == ["content", "events"]


def test_head_of_range_and_of_file_that_is_known(live: Live, addresses: list[str]) -> None:
    path = f"{addresses[10]}/results/person-1.bvh"
    headed = live.client.head(path, headers={"Range": "bytes=0-9"})
    assert (headed.status_code, headed.headers["content-length"]) == (206, "10")
    known = {"If-None-Match": headed.headers["etag"]}
    assert live.client.head(path, headers=known).status_code == 304


def test_head_is_refused_where_get_is(live: Live) -> None:
    answer = live.client.head(f"/v1/jobs/{live.job_id()}/cancel")
    assert (answer.status_code, answer.headers["allow"]) == (405, "POST")


def test_head_requests_are_counted_as_head(live: Live) -> None:
    live.client.head("/v1/jobs")
    assert 'method="HEAD",route="/v1/jobs"' in live.client.get("/metrics").text.replace(", ", ",")


@pytest.mark.parametrize("kind", ["session", "self", "options"])
def test_unchanged_records_are_answered_by_304(live: Live, kind: str) -> None:
    job = live.client.get(f"/v1/jobs/{live.job_id()}").json()
    address = (job["urls"] | {"options": "/v1/options"})[kind]
    first = live.client.get(address)
    etag = first.headers["etag"]
    assert not etag.startswith("W/")
    for header in (etag, f'"other", {etag}', f"W/{etag}", "*"):
        again = live.client.get(address, headers={"If-None-Match": header})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
        assert "content-length" not in again.headers or again.headers["content-length"] == "0"
    other = live.client.get(address, headers={"If-None-Match": '"other"'})
    assert (other.status_code, other.content, other.headers["etag"]) == (200, first.content, etag)


def test_cache_control_of_each_kind_of_address(live: Live, addresses: list[str]) -> None:
    kept = {"/": "no-cache", "/docs": "no-cache", "/portal/main.js": "no-cache", "/v1/options": "private, no-cache"}
    job, session, file = addresses[10], addresses[11], addresses[15]
    kept |= dict.fromkeys([job, session, file], "private, no-cache")
    said = {path: live.client.get(path).headers["cache-control"] for path in [*addresses, "/v1/options"]}
    assert said == dict.fromkeys(addresses, "no-store") | kept
    assert live.client.post("/v1/jobs").headers["cache-control"] == "no-store"


def test_tag_changes_with_body(live: Live) -> None:
    job_id = live.job_id()
    path = f"/v1/jobs/{job_id}"
    tags = [live.client.get(path).headers["etag"]]
    claim = live.services.store.leases.claim("test", 30.0)
    assert claim is not None
    tags.append(live.client.get(path).headers["etag"])
    live.services.store.leases.heartbeat(claim.chunk_id, claim.lease_token, 6, 30.0)
    answer = live.client.get(path, headers={"If-None-Match": ", ".join(tags)})
    assert (answer.status_code, answer.json()["stages"][0]["done"]) == (200, 6)
    live.client.post(f"{path}/cancel")
    tags.append(answer.headers["etag"])
    answer = live.client.get(path, headers={"If-None-Match": ", ".join(tags)})
    assert (answer.status_code, answer.json()["state"]) == (200, "canceling")
    assert len(set(tags)) == 3


def test_jobs_bear_their_session_s_name_and_length(live: Live) -> None:
    parts = [*form(), ("manifest", (None, b'{"name": "Take 3"}'))]
    made = live.client.post("/v1/jobs", files=parts).json()
    read = live.client.get(made["urls"]["self"]).json()
    (listed,) = live.client.get("/v1/jobs").json()["jobs"]
    for job in (made, read, listed):
        assert (job["session_name"], job["num_frames"], job["duration_s"]) == ("Take 3", 60, 2.4)


def test_jobs_by_session(live: Live) -> None:
    first, second = live.session_id(), live.session_id()
    made = [live.client.post(f"/v1/sessions/{session}/jobs").json()["id"] for session in (first, second, first)]
    for path in (f"/v1/jobs?session_id={first}", f"/v1/sessions/{first}/jobs"):
        assert [job["id"] for job in live.client.get(path).json()["jobs"]] == [made[2], made[0]]
    url = live.client.get(f"/v1/sessions/{second}").json()["urls"]["jobs"]
    assert [job["id"] for job in live.client.get(url).json()["jobs"]] == [made[1]]
    page = live.client.get(f"/v1/sessions/{first}/jobs?limit=1").json()
    page = live.client.get(f"/v1/sessions/{first}/jobs?limit=1&cursor={page['next_cursor']}").json()
    assert [job["id"] for job in page["jobs"]] == [made[0]]
    live.client.post(f"/v1/jobs/{made[0]}/cancel")
    page = live.client.get(f"/v1/sessions/{first}/jobs?state=canceled").json()
    assert [job["id"] for job in page["jobs"]] == [made[0]]
    assert live.client.get(f"/v1/jobs?session_id={UNKNOWN}").json() == {"jobs": [], "next_cursor": None}
    problem_of(live.client.get(f"/v1/sessions/{UNKNOWN}/jobs"), 404, "not_found")


def test_sessions_say_how_large_they_are(live: Live) -> None:
    session = live.client.post("/v1/sessions", files=form(2, b"v" * 1000, b"c" * 17)).json()
    assert session["num_bytes"] == 2017


def rate(answer: httpx2.Response) -> tuple[int, int, int]:
    limit, left, reset_s = (int(answer.headers[f"RateLimit-{name}"]) for name in ("Limit", "Remaining", "Reset"))
    return limit, left, reset_s


def test_answers_say_how_many_requests_are_left(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_requests_per_minute=3)) as live:
        answers = [live.client.get(path) for path in ("/v1/jobs", f"/v1/jobs/{UNKNOWN}")]
        answers += [live.client.head("/v1/sessions"), live.client.get("/v1/jobs")]
        assert [answer.status_code for answer in answers] == [200, 404, 200, 429]
        assert [rate(answer)[:2] for answer in answers] == [(3, 2), (3, 1), (3, 0), (3, 0)]
        assert all(1 <= rate(answer)[2] <= 60 for answer in answers)
        assert answers[-1].headers["retry-after"] == answers[-1].headers["ratelimit-reset"]
        assert "ratelimit-limit" not in live.client.get("/healthz").headers


def test_without_limit_nothing_is_left_of_it(live: Live) -> None:
    assert not [name for name in live.client.get("/v1/jobs").headers if name.startswith("ratelimit")]


def test_pages_from_elsewhere_may_read_exposed_headers(make_settings: Callable[..., Settings]) -> None:
    portal = "https://portal.example"
    with running(make_settings(allowed_origins=frozenset({portal}))) as live:
        _, secret = live.services.store.keys.add("mine", "x", {Scope.READ})
        headers = {"Origin": portal, "Authorization": f"Bearer {secret}"}
        exposed = live.client.get("/v1/jobs", headers=headers).headers["access-control-expose-headers"].lower()
        for name in ("idempotent-replayed", "ratelimit-limit", "ratelimit-remaining", "ratelimit-reset", "etag"):
            assert name in exposed.split(", ")
