"""Links, tried by strangers: each opens what its scope names, for its time, and nothing else."""

import contextlib
import io
import json
import re
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import httpx2
import pytest
from structlog.testing import capture_logs

from api.web.contract.openapi import COMMITTED
from api.web.settings import Settings
from tests.api.conftest import RESULT, Live, form, problem_of, running
from worker.store.model.rights import Key, LinkScope, Scope

USUAL = frozenset({Scope.READ, Scope.WRITE})
CONTRACT = json.loads(COMMITTED.read_text(encoding="utf-8"))


@dataclass
class Studio:
    """Service with keys, in which a tenant has two finished jobs of two sessions."""

    live: Live
    key: Key
    secret: str
    job_id: str
    session_id: str
    other_job_id: str
    other_session_id: str

    def ask(self, method: str, path: str, **options: Any) -> httpx2.Response:
        return self.live.client.request(method, path, headers={"Authorization": f"Bearer {self.secret}"}, **options)

    def link(self, scope: str, name: str | None = None, **more: Any) -> dict[str, Any]:
        answer = self.ask("POST", f"/v1/jobs/{self.job_id}/links", json={"scope": scope, "name": name, **more})
        assert answer.status_code == 201, answer.text
        document: dict[str, Any] = answer.json()
        return document

    def token(self, scope: str, name: str | None = None) -> str:
        return str(self.link(scope, name)["url"]).rpartition("?link=")[2]

    def open(self, path: str, token: str, method: str = "GET", **headers: str) -> httpx2.Response:
        return self.live.client.request(method, path, params={"link": token}, headers=headers)


@pytest.fixture(scope="module")
def studio(make_settings: Callable[..., Settings]) -> Iterator[Studio]:
    with running(make_settings(max_link_days=2.0, max_wrong_keys_per_minute=100_000)) as live:
        key, secret = live.services.store.keys.add("studio", "portal", USUAL)
        live.client.headers["Authorization"] = f"Bearer {secret}"
        ids = []
        for _ in range(2):
            session_id = live.session_id()
            spec = {"callback_url": None}
            job_id = live.client.post(f"/v1/sessions/{session_id}/jobs", json=spec).json()["id"]
            live.finish(job_id)
            ids += [job_id, session_id]
        del live.client.headers["Authorization"]
        yield Studio(live, key, secret, *ids)


def readable(studio: Studio) -> dict[str, str]:
    """Every address of the contract that GET answers, of the job, its session, and without ids."""
    ids = {
        "job_id": studio.job_id,
        "session_id": studio.session_id,
        "name": "person-1.bvh",
        "camera": "cam_0",
        "number": "0",
    }
    return {
        path: re.sub(r"\{(\w+)\}", lambda found: ids.get(found[1], studio.job_id), path)
        for path, item in CONTRACT["paths"].items()
        if "get" in item and path not in {"/healthz", "/readyz"}
    }


OPENED = {
    ("file", "person-1.bvh"): {"/v1/jobs/{job_id}/results/{name}"},
    ("file", "results.zip"): {"/v1/jobs/{job_id}/results.zip"},
    ("video", "cam_0"): {
        "/v1/sessions/{session_id}/thumbnails/{camera}/{number}",
        "/v1/sessions/{session_id}/videos/{camera}",
    },
    ("events", None): {"/v1/jobs/{job_id}/events"},
    ("job", None): {
        "/v1/jobs/{job_id}",
        "/v1/jobs/{job_id}/events",
        "/v1/jobs/{job_id}/motion",
        "/v1/jobs/{job_id}/motion/description",
        "/v1/jobs/{job_id}/motion/first-people",
        "/v1/jobs/{job_id}/results",
        "/v1/jobs/{job_id}/results.zip",
        "/v1/jobs/{job_id}/results/{name}",
        "/v1/sessions/{session_id}",
        "/v1/sessions/{session_id}/thumbnails/{camera}/{number}",
        "/v1/sessions/{session_id}/videos/{camera}",
    },
}


@pytest.mark.parametrize(("scope", "name"), OPENED)
def test_link_opens_what_its_scope_names_and_nothing_else(studio: Studio, scope: str, name: str | None) -> None:
    token = studio.token(scope, name)
    opened = set()
    for path, address in readable(studio).items():
        for method in ("GET", "HEAD"):
            answer = studio.open(address, token, method)
            # This service's jobs have no motion: the link opens the address, and the file is not there.
            if answer.status_code == 200 or (answer.status_code == 404 and "/motion" in path and scope == "job"):
                opened.add(path)
            else:
                assert answer.status_code in {401, 404}, (method, path)
    assert opened == OPENED[scope, name]


@pytest.mark.parametrize(("scope", "name"), OPENED)
def test_link_changes_nothing(studio: Studio, scope: str, name: str | None) -> None:
    token = studio.token(scope, name)
    ids = {"job_id": studio.job_id, "session_id": studio.session_id, "link_id": studio.link("job")["id"]}
    for path, item in CONTRACT["paths"].items():
        for method in {"post", "patch", "delete", "put"} & item.keys():
            if path == "/v1/browser-session":
                continue
            address = re.sub(r"\{(\w+)\}", lambda found: ids.get(found[1], studio.job_id), path)
            answer = studio.open(address, token, method.upper())
            assert answer.status_code == 401, (method, path)
    assert studio.ask("GET", f"/v1/jobs/{studio.job_id}").status_code == 200


@pytest.mark.parametrize(("scope", "name"), OPENED)
def test_link_opens_no_other_job_or_file(studio: Studio, scope: str, name: str | None) -> None:
    token = studio.token(scope, name)
    job, session, other = f"/v1/jobs/{studio.job_id}", f"/v1/sessions/{studio.session_id}", studio.other_job_id
    addresses = [
        *(f"/v1/jobs/{other}{path}" for path in ("", "/events", "/results", "/results.zip", "/results/person-1.bvh")),
        *(f"/v1/sessions/{studio.other_session_id}{path}" for path in ("", "/videos/cam_0")),
        f"/v1/jobs/{other}/results/..%2f..%2f{studio.job_id}%2fresults%2fperson-1.bvh",
        f"{job}/results/..%2fresults.zip",
        f"{job}/results/%2e%2e",
        f"{session}/videos/..%2f..%2f",
        *([f"{job}/results/other.bvh", f"{session}/videos/cam_1"] if scope != "job" else []),
    ]
    for address in addresses:
        assert studio.open(address, token).status_code == 404, address


def test_links_that_are_no_longer_valid(studio: Studio) -> None:
    path = f"/v1/jobs/{studio.job_id}/results/person-1.bvh"
    revoked = studio.link("file", "person-1.bvh")
    assert studio.live.client.get(revoked["url"]).content == RESULT
    assert studio.ask("DELETE", f"/v1/links/{revoked['id']}").status_code == 204
    key, secret = studio.live.services.store.keys.add("studio", "other", USUAL)
    headers = {"Authorization": f"Bearer {secret}"}
    of_key = studio.live.client.post(f"/v1/jobs/{studio.job_id}/links", json={"scope": "job"}, headers=headers).json()
    token = of_key["url"].rpartition("?link=")[2]
    assert studio.open(path, token).status_code == 200
    studio.live.services.store.keys.revoke(key.id)
    _, ended = studio.live.services.store.tenant("studio").links.add(studio.job_id, LinkScope.JOB, None, -1.0)
    wrong = [revoked["url"].rpartition("?link=")[2], token, ended, "mcl_", "x" * 5000, studio.secret, revoked["id"]]
    for secret in [*wrong, "\u2603", "mcl_" + "A" * 43]:
        answer = studio.open(path, secret)
        problem_of(answer, 401, "link_unknown")
        assert secret not in answer.text
    problem_of(studio.ask("DELETE", f"/v1/links/{revoked['id']}"), 404, "not_found")


def test_stream_ends_with_its_link(studio: Studio) -> None:
    """The stream of an unfinished job would go on."""
    session_id = studio.ask("POST", "/v1/sessions", files=form()).json()["id"]
    job_id = studio.ask("POST", f"/v1/sessions/{session_id}/jobs", json={}).json()["id"]
    link = studio.ask("POST", f"/v1/jobs/{job_id}/links", json={"scope": "events"}).json()
    with studio.live.client.stream("GET", link["url"], timeout=180) as answer:
        lines = answer.iter_lines()
        assert next(line for line in lines if line.startswith("event:")) == "event: job"
        assert studio.ask("DELETE", f"/v1/links/{link['id']}").status_code == 204
        started_s = time.monotonic()
        with contextlib.suppress(httpx2.RemoteProtocolError):
            list(lines)
        assert time.monotonic() - started_s < 10.0
    studio.ask("POST", f"/v1/jobs/{job_id}/cancel")


def test_rights_of_link_count_even_with_key(studio: Studio) -> None:
    token = studio.token("file", "person-1.bvh")
    answer = studio.ask("GET", f"/v1/jobs/{studio.job_id}", params={"link": token})
    problem_of(answer, 404, "not_found")
    problem_of(studio.ask("GET", f"/v1/jobs/{studio.job_id}", params={"link": "mcl_x"}), 401, "link_unknown")


def test_link_to_job_shows_nothing_else_of_tenant(studio: Studio) -> None:
    token = studio.token("job")
    job = studio.open(f"/v1/jobs/{studio.job_id}", token).json()
    assert (job["state"], job["spec"]["callback_url"], job["urls"]["retry"]) == ("succeeded", None, None)
    session = studio.open(f"/v1/sessions/{studio.session_id}", token).json()
    assert (session["metadata"], session["newest_job"]) == ({}, None)
    assert session["preflight"]["cameras"][0]["name"] == "cam_0"
    events = studio.open(f"/v1/jobs/{studio.job_id}/events", token)
    assert json.loads(events.text.split("data: ")[1].splitlines()[0])["id"] == studio.job_id


def test_downloads_and_ranges(studio: Studio) -> None:
    with zipfile.ZipFile(
        io.BytesIO(studio.live.client.get(studio.link("file", "results.zip")["url"]).content)
    ) as found:
        assert found.read("person-1/untitled_person-1.bvh") == RESULT
    part = studio.live.client.get(studio.link("video", "cam_0")["url"], headers={"Range": "bytes=1-3"})
    assert (part.status_code, part.content) == (206, b"ide")
    # Pages of other origins may show it, and learn nothing from their address.
    assert part.headers["cross-origin-resource-policy"] == "cross-origin"
    assert part.headers["referrer-policy"] == "no-referrer"
    assert "set-cookie" not in part.headers
    own = studio.ask("GET", f"/v1/jobs/{studio.job_id}")
    assert own.headers["cross-origin-resource-policy"] == "same-origin"


def test_links_are_listed_without_their_secrets(studio: Studio) -> None:
    made = studio.link("events", expires_in_s=60)
    token = made["url"].rpartition("?link=")[2]
    listed = studio.ask("GET", f"/v1/jobs/{studio.job_id}/links")
    assert listed.json()["links"][0] == {name: made[name] for name in made.keys() - {"url"}}
    assert token not in listed.text


def test_page_gets_secret_behind_hash(studio: Studio) -> None:
    assert re.fullmatch(rf"/#/jobs/{studio.job_id}\?link=mcl_[\w-]{{43}}", studio.link("job")["url"])


@pytest.mark.parametrize(
    ("body", "pointers"),
    [
        ({}, {("/scope", "missing_field")}),
        ({"scope": "tenant"}, {("/scope", "value_not_allowed")}),
        ({"scope": "file"}, {("/name", "missing_field")}),
        ({"scope": "job", "name": "person-1.bvh"}, {("/name", "unknown_field")}),
        ({"scope": "file", "expires_in_s": 172_801}, {("/name", "missing_field"), ("/expires_in_s", "out_of_range")}),
        ({"scope": "events", "expires_in_s": 0}, {("/expires_in_s", "out_of_range")}),
        ({"scope": "events", "tenant": "other"}, {("/tenant", "unknown_field")}),
    ],
)
def test_wrong_links(studio: Studio, body: dict[str, Any], pointers: set[tuple[str, str]]) -> None:
    answer = studio.ask("POST", f"/v1/jobs/{studio.job_id}/links", json=body)
    problem = problem_of(answer, 422, "invalid_request")
    assert {(item["pointer"], item["code"]) for item in problem["errors"]} == pointers


@pytest.mark.parametrize(("scope", "name"), [("file", "person-2.bvh"), ("video", "cam_9"), ("file", "../results.zip")])
def test_links_to_what_is_not_there(studio: Studio, scope: str, name: str) -> None:
    answer = studio.ask("POST", f"/v1/jobs/{studio.job_id}/links", json={"scope": scope, "name": name})
    problem_of(answer, 404, "not_found")


def test_lifetime_by_default_is_within_limit(studio: Studio) -> None:
    answer = studio.ask("POST", f"/v1/jobs/{studio.job_id}/links", json={"scope": "job"})
    assert answer.status_code == 201, answer.text


def test_log_has_no_secret(studio: Studio) -> None:
    token = studio.token("file", "person-1.bvh")
    with capture_logs() as lines:
        for path in (f"/v1/jobs/{studio.job_id}/results/person-1.bvh", f"/v1/jobs/{studio.job_id}"):
            studio.open(path, token)
            studio.open(path, token + "x")
    requests = [line for line in lines if line["event"] == "request"]
    assert [line["status"] for line in requests] == [200, 401, 404, 401]
    assert requests[0]["link"]
    assert token not in str(lines)


@pytest.mark.slow
def test_strangers_use_up_requests_of_their_link_alone(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_requests_per_minute=20)) as live:
        job_id = live.job_id()
        live.finish(job_id)
        made = live.client.post(f"/v1/jobs/{job_id}/links", json={"scope": "file", "name": "person-1.bvh"}).json()
        answers = [live.client.get(made["url"]).status_code for _ in range(22)]
        assert (answers.count(200), answers.count(429)) == (20, 2)
        assert live.client.get(f"/v1/jobs/{job_id}").status_code == 200
