"""Middleware: request ids, safe headers, allowed hosts and origins."""

from collections.abc import Callable

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, problem_of, raw, running


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:80", "127.0.0.1", "[::1]:8000"])
def test_loopback_names_are_served(live: Live, host: str) -> None:
    assert live.client.get("/healthz", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "evil@localhost:1]", "[::1", ""]
)
def test_other_names_are_refused(live: Live, host: str) -> None:
    problem_of(live.client.get("/v1/jobs", headers={"Host": host}), 403, "host_not_allowed")


def test_two_names_are_refused(live: Live) -> None:
    request = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
    assert raw(live.address, request).split(b"\r\n")[0].split()[1] in {b"400", b"403"}


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://localhost:1", "http://127.0.0.1", "", "file://"]
)
def test_pages_from_elsewhere_are_refused(live: Live, origin: str) -> None:
    answer = live.client.post("/v1/sessions", headers={"Origin": origin})
    problem_of(answer, 403, "origin_not_allowed")


def test_own_page_is_served(live: Live) -> None:
    origin = f"http://127.0.0.1:{live.address[1]}"
    assert live.client.get("/v1/jobs", headers={"Origin": origin}).status_code == 200


def test_allowed_hosts_are_served(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(allowed_hosts=frozenset({"Capture.example"}))) as live:
        assert live.client.get("/healthz", headers={"Host": "capture.example:8000"}).status_code == 200
        problem_of(live.client.get("/healthz", headers={"Host": "other.example"}), 403, "host_not_allowed")


@pytest.mark.parametrize("path", ["/", "/healthz", "/nowhere", "/portal/main.js"])
def test_every_answer_has_safe_headers(live: Live, path: str) -> None:
    headers = live.client.get(path).headers
    assert headers["x-content-type-options"] == "nosniff"
    policy = headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self';")
    assert "unsafe" not in policy
    assert "access-control-allow-origin" not in headers
