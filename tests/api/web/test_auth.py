"""Authorization: every route of the contract with missing, wrong and weak keys, and keys of another tenant."""

import contextlib
import hashlib
import json
import re
import socket
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest
from structlog.testing import capture_logs

from api.web.app import create_app
from api.web.contract.openapi import COMMITTED
from api.web.settings import Settings
from api.web.startup import ExposedError, require_keys_if_exposed
from pipeline.core.options.edits import PersonSpan
from tests.api.conftest import Live, form, problem_of, running
from tests.small_disk import fill, small_disk
from worker.store.files.artifacts import default_data_dir
from worker.store.files.file_keys import character_key
from worker.store.model.character_records import StoredCharacterFile
from worker.store.model.rights import Actor, Key, LinkScope, Scope
from worker.store.tenant_records import TenantRecords

CONTRACT = json.loads(COMMITTED.read_text(encoding="utf-8"))
MOTION = CONTRACT["components"]["examples"]["MotionDescription"]["value"]
OPERATIONS = [
    (method.upper(), path)
    for path, item in CONTRACT["paths"].items()
    for method in item
    if method in {"get", "head", "post", "put", "patch", "delete"}
]
# Routes that need no key: health, and signing a browser in and out.
OPEN = {("GET", "/healthz"), ("GET", "/readyz"), ("POST", "/v1/browser-session"), ("DELETE", "/v1/browser-session")}
GUARDED = [one for one in OPERATIONS if one not in OPEN]
# Files of the sample capture belong to no tenant.
OWNED = [one for one in GUARDED if "{" in one[1] and not one[1].startswith("/v1/sample/")]
ADMIN = ("GET", "/metrics")
ANY_KEY = ("GET", "/v1/caller")

# Valid piece of an upload of another tenant.
TUS = {
    "Tus-Resumable": "1.0.0",
    "Upload-Length": "10",
    "Upload-Metadata": "filename Y2FtXzAubXA0",
    "Upload-Offset": "0",
    "Content-Type": "application/offset+octet-stream",
}

ALL = frozenset(Scope)
USUAL = frozenset({Scope.READ, Scope.WRITE})


@dataclass
class Guarded:
    """Service with keys; the tenant ``theirs`` has a session with a finished and an unfinished job."""

    live: Live
    ids: dict[str, str]
    theirs: str
    mine: str

    def key(self, scopes: frozenset[Scope], tenant: str = "theirs", lifetime_s: float | None = None) -> tuple[Key, str]:
        return self.live.services.store.keys.add(tenant, "test", scopes, lifetime_s)

    def ask(self, method: str, path: str, secret: str | None, **options: Any) -> httpx2.Response:
        headers = {"Authorization": f"Bearer {secret}"} if secret is not None else {}
        address = re.sub(r"\{(\w+)\}", lambda found: self.ids[found[1]], path)
        if method == "POST" and re.fullmatch("/v1/(calibrations|characters|sessions|jobs)(/from-files)?", path):
            options.setdefault("files", form())
        if method == "POST" and path.endswith("/from-uploads"):
            options.setdefault("json", {})
        if method == "PATCH" and re.fullmatch(r"/v1/(calibrations|characters|sessions)/\{\w+\}", path):
            options.setdefault("json", {"name": "walk"})
        if path.endswith("/takes/{take}/session"):
            options.setdefault("json", {"calibration_id": self.ids["calibration_id"]})
        if path.endswith("/takes/{take}/calibration"):
            options.setdefault("json", {"stature_m": [1.8]})
        if (method, path) == ("PUT", "/v1/sessions/{session_id}/edits"):
            options.setdefault("json", {"edits": []})
        if (method, path) == ("POST", "/v1/jobs/{job_id}/links"):
            options.setdefault("json", {"scope": "job"})
        if path.startswith("/v1/uploads"):
            headers |= TUS
            options |= {"content": b"video"} if method == "PATCH" else {}
        return self.live.client.request(method, address, headers=headers, **options)


def refused(answer: httpx2.Response, status: int, code: str) -> None:
    """Check a refusal; responses to HEAD have no body."""
    if answer.request.method == "HEAD":
        assert answer.status_code == status
    else:
        problem_of(answer, status, code)


def character_of(live: Live, records: TenantRecords) -> str:
    """Id of a stored character."""
    summary = {"format": "GLB", "method": "names", "stature": 1.7, "num_bones": 0, "num_vertices": 0}
    bones: dict[str, Any] = {
        "joints": [],
        "spine": [],
        "neck": [],
        "twists": {},
        "at_rest": [],
        "warnings": [],
        "skeleton": [],
    }
    character_id = records.characters.reserve_id()
    file = StoredCharacterFile("robot.glb", character_key(character_id), 5, hashlib.sha256(b"robot").hexdigest())
    live.services.artifacts.put_bytes(file.key, b"robot")
    return records.characters.add(character_id, "Robot", file, summary, bones, {}).id


@pytest.fixture(scope="module")
def guarded(make_settings: Callable[..., Settings]) -> Iterator[Guarded]:
    with running(make_settings(max_json_bytes=64 * 1024, max_wrong_keys_per_minute=100_000)) as live:
        key, theirs = live.services.store.keys.add("theirs", "portal", USUAL)
        _, mine = live.services.store.keys.add("mine", "portal", ALL)
        live.client.headers["Authorization"] = f"Bearer {theirs}"
        job_id = live.job_id()
        live.finish(
            job_id,
            motion={"motion.bin": bytes(300 * 48), "motion.json": json.dumps(MOTION).encode()},
            people=[PersonSpan(1, 0, 60)],
        )
        session_id = live.client.get(f"/v1/jobs/{job_id}").json()["session_id"]
        upload = live.client.post("/v1/uploads", headers=TUS).headers["location"]
        del live.client.headers["Authorization"]
        records = live.services.store.tenant("theirs", actor=Actor(key.id))
        ids = {
            "character_id": character_of(live, records),
            "calibration_id": records.calibrations.add("Studio", {}, '{"cameras": []}').id,
            "session_id": session_id,
            "job_id": job_id,
            "name": "person-1.bvh",
            "camera": "cam_0",
            "number": "0",
            "link_id": records.links.add(job_id, LinkScope.EVENTS, None, 3600.0)[0].id,
            "upload_id": upload.rpartition("/")[2],
            "sample_file": "cam01.mp4",
            "recording_id": records.recordings.add("Rehearsal", 3600.0)[0].id,
            "take": "1",
        }
        yield Guarded(live, ids, theirs, mine)


def test_contract_says_which_calls_want_key() -> None:
    for method, path in OPERATIONS:
        operation = CONTRACT["paths"][path][method.lower()]
        assert ("401" in operation["responses"]) == ((method, path) not in OPEN - {("POST", "/v1/browser-session")})
        assert bool(operation.get("security")) == ((method, path) not in OPEN)


@pytest.mark.parametrize(("method", "path"), GUARDED)
def test_without_valid_key_there_is_nothing(guarded: Guarded, method: str, path: str) -> None:
    revoked, revoked_secret = guarded.key(ALL)
    guarded.live.services.store.keys.revoke(revoked.id)
    _, expired_secret = guarded.key(ALL, lifetime_s=-1.0)
    for secret in (None, revoked_secret, expired_secret, "mc_unknown", "x" * 5000):
        answer = guarded.ask(method, path, secret)
        refused(answer, 401, "key_required")
        assert answer.headers["www-authenticate"] == "Bearer"


@pytest.mark.parametrize(("method", "path"), [one for one in GUARDED if one != ANY_KEY])
def test_key_that_is_too_weak_is_refused(guarded: Guarded, method: str, path: str) -> None:
    wanted = Scope.ADMIN if (method, path) == ADMIN else Scope.READ if method in {"GET", "HEAD"} else Scope.WRITE
    _, weak = guarded.key(ALL - {wanted})
    refused(guarded.ask(method, path, weak), 403, "scope_missing")


@pytest.mark.parametrize(("method", "path"), OWNED)
def test_records_of_another_tenant_are_not_found(guarded: Guarded, method: str, path: str) -> None:
    refused(guarded.ask(method, path, guarded.mine), 404, "not_found")


@pytest.mark.parametrize(
    ("method", "path"), [one for one in OWNED if one[0] in {"GET", "HEAD"} and "events" not in one[1]]
)
def test_records_of_own_tenant_are_found(guarded: Guarded, method: str, path: str) -> None:
    assert guarded.ask(method, path, guarded.theirs).status_code == 200


def test_another_tenant_s_upload_makes_no_session(guarded: Guarded) -> None:
    files = {"videos": [guarded.ids["upload_id"]], "calibration": guarded.ids["upload_id"]}
    for path in ("/v1/sessions", "/v1/jobs", "/v1/sessions/from-uploads", "/v1/jobs/from-uploads"):
        answer = guarded.ask("POST", path, guarded.mine, json=files, files=None)
        problem = problem_of(answer, 422, "invalid_request")
        assert {item["code"] for item in problem["errors"]} == {"upload_unknown"}


def test_another_tenant_s_footage_makes_no_session(guarded: Guarded) -> None:
    body = {"session_id": guarded.ids["session_id"], "calibration_id": guarded.ids["calibration_id"]}
    for path in ("/v1/sessions", "/v1/jobs", "/v1/sessions/from-uploads", "/v1/jobs/from-uploads"):
        answer = guarded.ask("POST", path, guarded.mine, json=body, files=None)
        problem = problem_of(answer, 422, "invalid_request")
        assert {item["code"] for item in problem["errors"]} == {"session_unknown", "calibration_unknown"}


def test_lists_show_caller_s_own(guarded: Guarded) -> None:
    for path, name in (("/v1/sessions", "sessions"), ("/v1/jobs", "jobs")):
        assert guarded.ask("GET", path, guarded.mine).json()[name] == []
        assert len(guarded.ask("GET", path, guarded.theirs).json()[name]) == 1
    answer = guarded.ask("POST", "/v1/sessions", guarded.mine)
    assert answer.status_code == 201
    assert (
        guarded.live.client.get(
            answer.headers["location"], headers={"Authorization": f"Bearer {guarded.theirs}"}
        ).status_code
        == 404
    )
    assert guarded.ask("DELETE", answer.headers["location"], guarded.mine).status_code == 204


def test_another_tenant_s_session_filters_nothing_out_of_it(guarded: Guarded) -> None:
    session_id = guarded.ids["session_id"]
    empty: dict[str, Any] = {"jobs": [], "next_cursor": None}
    assert guarded.ask("GET", f"/v1/jobs?session_id={session_id}", guarded.mine).json() == empty
    assert len(guarded.ask("GET", f"/v1/jobs?session_id={session_id}", guarded.theirs).json()["jobs"]) == 1
    problem_of(guarded.ask("GET", f"/v1/sessions/{session_id}/jobs", guarded.mine), 404, "not_found")


@pytest.mark.parametrize("path", ["/v1/jobs/{job_id}", "/v1/sessions/{session_id}", "/v1/jobs/{job_id}/results/{name}"])
def test_another_tenant_s_tags_say_nothing(guarded: Guarded, path: str) -> None:
    address = path.format(**guarded.ids)
    theirs, mine = ({"Authorization": f"Bearer {secret}"} for secret in (guarded.theirs, guarded.mine))
    etag = guarded.live.client.get(address, headers=theirs).headers["etag"]
    for header in (etag, "*"):
        known = {"If-None-Match": header}
        assert guarded.live.client.get(address, headers=theirs | known).status_code == 304
        problem_of(guarded.live.client.get(address, headers=mine | known), 404, "not_found")
        assert guarded.live.client.head(address, headers=mine | known).status_code == 404


def test_upload_without_key_is_refused_before_it_is_sent(guarded: Guarded) -> None:
    head = (
        b"POST /v1/sessions HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=x\r\n"
        b"Content-Length: 100000\r\nConnection: close\r\n\r\n"
    )
    with socket.create_connection(guarded.live.address[:2], timeout=180) as connection:
        connection.sendall(head)
        assert connection.recv(65536).split(b"\r\n")[0].split()[1] == b"401"


@pytest.mark.parametrize("header", ["Basic bWM6eA==", "Bearer", "mc_x", "Bearer a b"])
def test_other_ways_to_authorize_are_refused(guarded: Guarded, header: str) -> None:
    answer = guarded.live.client.get("/v1/jobs", headers={"Authorization": header})
    problem_of(answer, 401, "key_required")


def test_caller(guarded: Guarded) -> None:
    caller = guarded.ask("GET", "/v1/caller", guarded.mine).json()
    assert caller.pop("quotas")["sessions"] == {"used": 0, "limit": None}
    assert caller == {
        "tenant": "mine",
        "name": "portal",
        "scopes": ["admin", "read", "write"],
        "expires_at": None,
    }


def test_without_keys_everybody_may_do_everything(live: Live) -> None:
    caller = live.client.get("/v1/caller").json()
    del caller["quotas"]
    assert caller == {
        "tenant": "default",
        "name": None,
        "scopes": ["admin", "read", "write"],
        "expires_at": None,
    }
    problem_of(live.client.get("/v1/jobs", headers={"Authorization": "Bearer mc_x"}), 401, "key_required")


class TestBrowser:
    """Browsers that have signed in use a cookie."""

    @pytest.fixture
    def browser(self, guarded: Guarded) -> Iterator[httpx2.Client]:
        with httpx2.Client(base_url=guarded.live.client.base_url) as client:
            client.headers["Origin"] = f"http://{client.base_url.host}:{client.base_url.port}"
            client.post("/v1/browser-session", json={"key": guarded.theirs}).raise_for_status()
            yield client

    def test_cookie_is_for_this_service_alone(self, guarded: Guarded) -> None:
        answer = guarded.live.client.post("/v1/browser-session", json={"key": guarded.theirs})
        guarded.live.client.cookies.clear()
        attributes = {part.strip().lower() for part in answer.headers["set-cookie"].split(";")[1:]}
        assert {"httponly", "samesite=strict", "path=/", "max-age=43200"} <= attributes

    def test_browser_has_scopes_of_its_key(self, guarded: Guarded, browser: httpx2.Client) -> None:
        assert browser.get("/v1/caller").json()["tenant"] == "theirs"
        assert browser.get(f"/v1/jobs/{guarded.ids['job_id']}/results/person-1.bvh").status_code == 200
        session = browser.post("/v1/sessions", files=form()).raise_for_status().json()
        assert browser.delete(f"/v1/sessions/{session['id']}").status_code == 204

    @pytest.mark.parametrize("origin", [None, "null", "http://localhost", "http://evil.example"])
    def test_other_pages_change_nothing_by_it(
        self, guarded: Guarded, browser: httpx2.Client, origin: str | None
    ) -> None:
        del browser.headers["Origin"]
        headers = {} if origin is None else {"Origin": origin}
        answer = browser.delete(f"/v1/sessions/{guarded.ids['session_id']}", headers=headers)
        assert answer.status_code == 403
        assert answer.json()["code"] in {"cross_site_request", "origin_not_allowed"}

    def test_browser_session_ends_when_it_is_closed(self, browser: httpx2.Client) -> None:
        cookies = dict(browser.cookies)
        assert browser.delete("/v1/browser-session").status_code == 204
        assert not browser.cookies
        browser.cookies.update(cookies)
        problem_of(browser.get("/v1/jobs"), 401, "key_required")

    def test_browser_session_ends_with_its_key(self, guarded: Guarded, browser: httpx2.Client) -> None:
        key, secret = guarded.key(USUAL)
        browser.post("/v1/browser-session", json={"key": secret}).raise_for_status()
        assert browser.get("/v1/jobs").status_code == 200
        guarded.live.services.store.keys.revoke(key.id)
        problem_of(browser.get("/v1/jobs"), 401, "key_required")

    def test_wrong_keys_open_nothing(self, guarded: Guarded) -> None:
        for key in ("", "mc_", guarded.theirs[:-1]):
            answer = guarded.live.client.post("/v1/browser-session", json={"key": key})
            problem_of(answer, 401, "key_required")
            assert "set-cookie" not in answer.headers


def test_over_tls_cookie_is_of_this_host_alone(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(trusted_proxies=frozenset({"127.0.0.1"}))) as live:
        _, secret = live.services.store.keys.add("mine", "portal", USUAL)
        live.client.headers |= {"X-Forwarded-Proto": "https", "Origin": f"https://127.0.0.1:{live.address[1]}"}
        answer = live.client.post("/v1/browser-session", json={"key": secret})
        (kept,) = answer.headers.get_list("set-cookie")
        name, _, value = kept.partition(";")[0].partition("=")
        attributes = {part.strip().lower() for part in kept.split(";")[1:]}
        assert name == "__Host-multicap_session"
        assert {"secure", "httponly", "samesite=strict", "path=/"} <= attributes
        assert not any(attribute.startswith("domain") for attribute in attributes)
        live.client.cookies.clear()
        assert live.client.get("/v1/jobs", headers={"Cookie": f"{name}={value}"}).status_code == 200
        # Another host of the domain may have set a cookie without the prefix.
        foreign = live.client.get("/v1/jobs", headers={"Cookie": f"multicap_session={value}"})
        problem_of(foreign, 401, "key_required")
        live.client.cookies.clear()
        ended = live.client.delete("/v1/browser-session", headers={"Cookie": f"{name}={value}"})
        assert {line.partition("=")[0] for line in ended.headers.get_list("set-cookie")} == {name}
        problem_of(live.client.get("/v1/jobs", headers={"Cookie": f"{name}={value}"}), 401, "key_required")


def test_browsers_come_and_go_on_full_disk(make_settings: Callable[..., Settings], tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 64) as disk, running(make_settings(data_dir=disk / "data")) as live:
        _, secret = live.services.store.keys.add("mine", "portal", USUAL)
        requests: list[tuple[str, dict[str, Any]]] = [("POST", {"json": {"key": secret}}), ("DELETE", {})]
        for number, (method, sent) in enumerate(requests):
            live.services.disk.set_aside()
            with contextlib.closing(sqlite3.connect(disk / "data" / "multicap.db")) as database:
                database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            fill(disk / f"filler {number}")
            assert live.client.request(method, "/v1/browser-session", **sent).status_code == 204
            (disk / f"filler {number}").unlink()
        assert not live.client.cookies


def test_pages_of_allowed_origins_may_call(make_settings: Callable[..., Settings]) -> None:
    portal = "https://portal.example"
    with running(make_settings(allowed_origins=frozenset({portal}))) as live:
        asked = {"Origin": portal, "Access-Control-Request-Method": "GET"}
        answer = live.client.options("/v1/jobs", headers=asked | {"Access-Control-Request-Headers": "authorization"})
        assert answer.status_code == 200
        assert answer.headers["access-control-allow-origin"] == portal
        assert "authorization" in answer.headers["access-control-allow-headers"].lower()
        assert "access-control-allow-credentials" not in answer.headers
        answer = live.client.get("/v1/jobs", headers={"Origin": portal})
        assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, portal)
        problem_of(live.client.get("/v1/jobs", headers={"Origin": "https://else.example"}), 403, "origin_not_allowed")


def test_beyond_this_machine_it_listens_with_keys_only(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    exposed = settings.model_copy(update={"host": "0.0.0.0"})  # noqa: S104
    with running(settings) as live:
        store = live.services.store
        require_keys_if_exposed(settings, store)
        with pytest.raises(ExposedError, match=f"`multicap keys create NAME --data {settings.data_dir}`"):
            require_keys_if_exposed(exposed, store)
        usual = exposed.model_copy(update={"data_dir": default_data_dir()})
        with pytest.raises(ExposedError, match="`multicap keys create NAME`"):
            require_keys_if_exposed(usual, store)
        require_keys_if_exposed(exposed.model_copy(update={"trust_network": True}), store)
        key, _ = store.keys.add("mine", "portal", USUAL)
        require_keys_if_exposed(exposed, store)
        store.keys.revoke(key.id)
        require_keys_if_exposed(exposed, store)  # the only key is not valid, but the service asks for keys


def test_log_says_who_did_what(guarded: Guarded) -> None:
    with capture_logs() as seen:
        guarded.ask("GET", "/v1/jobs", guarded.mine)
        guarded.ask("GET", "/v1/jobs", None)
    known, unknown = (line for line in seen if line["event"] == "request")
    assert known["tenant"] == "mine"
    assert guarded.mine not in str(seen)
    assert "key" not in unknown


def test_app_can_be_made_without_touching_anything(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings(host="0.0.0.0")  # noqa: S104
    create_app(settings)
    assert not settings.data_dir.exists()


def test_audit_says_by_which_key_and_request(guarded: Guarded) -> None:
    answer = guarded.ask("POST", "/v1/sessions", guarded.mine)
    session_id = answer.json()["id"]
    problem_of(guarded.live.client.delete(f"/v1/sessions/{session_id}"), 401, "key_required")
    event = guarded.live.services.store.audit.events("mine", limit=1)[0]
    key = guarded.live.services.store.keys.find(guarded.mine)
    assert key is not None
    assert (event.act, event.subject) == ("session-created", session_id)
    assert (event.key_id, event.request_id) == (key.id, answer.headers["x-request-id"])
