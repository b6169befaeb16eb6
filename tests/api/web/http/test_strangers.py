"""Unusual requests: each is answered or its connection closed, none fails, and the log stays small."""

import contextlib
import socket
from collections.abc import Callable, Iterator

import pytest

from api.web.settings import MIB, Settings
from tests.api.conftest import Live, form, problem_of, raw, running
from tests.api.processes import peak_bytes, serving

LONG = "a" * 60_000


@pytest.fixture(scope="module")
def live(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings(max_json_bytes=64 * 1024)) as live:
        yield live


@pytest.mark.parametrize(
    "request_",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"TRACE / HTTP/1.1\r\nHost: localhost\r\nX-Secret: 1\r\n\r\n",
        b"CONNECT localhost:80 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET http://localhost/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET //localhost/healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"PROPFIND / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /%00%ff%2e%2e/%c0%af HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.0\r\n\r\n",
        b"GET / HTTP/9.9\r\nHost: localhost\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n" + b"a:\r\n" * 15_000 + b"\r\n",
        b"GET /v1/jobs?" + b"&".join(b"%d=" % k for k in range(8000)) + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /v1/jobs?" + b"limit=1&" * 7000 + b" HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nCookie: " + b"a=b; " * 12_000 + b"\r\n\r\n",
        b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nIf-None-Match: " + b'"a", ' * 10_000 + b"\r\n\r\n",
        b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nAccept-Encoding: " + b"gzip;q=0.1, " * 5000 + b"\r\n\r\n",
    ],
)
def test_odd_requests_are_answered_or_closed(live: Live, request_: bytes) -> None:
    with socket.create_connection(live.address[:2], timeout=180) as connection:
        connection.sendall(request_)
        with contextlib.suppress(ConnectionResetError):
            answer = connection.recv(65536)
            assert not answer or int(answer.split()[1]) < 500
    assert b"X-Secret" not in answer
    assert live.client.get("/healthz").status_code == 200


def test_connection_after_upgrade_is_usable_or_closed(live: Live) -> None:
    upgrade = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\r\n"
    with socket.create_connection(live.address[:2], timeout=180) as connection:
        connection.sendall(upgrade)
        assert connection.recv(65536).startswith((b"HTTP/1.1 200", b"HTTP/1.1 400"))
        with contextlib.suppress(ConnectionResetError, BrokenPipeError):  # the service has closed it
            connection.sendall(upgrade)
            answer = connection.recv(65536)
            assert not answer or answer.startswith((b"HTTP/1.1 200", b"HTTP/1.1 400"))


@pytest.mark.parametrize("opening", ["[", '{"a":', '{"spec":[', '{"manifest":{"metadata":['])
def test_json_of_any_depth_is_refused(live: Live, opening: str) -> None:
    nested = opening * (60_000 // len(opening))
    session_id = live.session_id()
    headers = {"Content-Type": "application/json"}
    for path in ("/v1/sessions", "/v1/jobs", f"/v1/sessions/{session_id}/jobs", "/v1/browser-session"):
        assert live.client.post(path, content=nested, headers=headers).status_code in {400, 422}
    for part in ("manifest", "spec"):
        answer = live.client.post("/v1/jobs", files=[*form(), (part, (None, nested))])
        assert answer.status_code in {400, 413, 422}


@pytest.mark.parametrize(
    ("part", "count"),
    [
        (b'Content-Disposition: form-data; name="x%d"\r\n\r\n\r\n', 20_000),
        (b'Content-Disposition: form-data; name="videos"; filename="%d.mp4"\r\n\r\n\r\n', 2_000),
        (b"X-%d: " + b"a" * 200_000 + b"\r\n\r\n", 1),
        (b"".join(b"X-%d: a\r\n" % k for k in range(1000)) + b"Y-%d: \r\n\r\n", 1),
    ],
)
def test_forms_of_any_shape_are_refused(live: Live, part: bytes, count: int) -> None:
    body = b"".join(b"--x\r\n" + part.replace(b"%d", b"%d" % k) + b"\r\n" for k in range(count)) + b"--x--\r\n"
    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    answer = live.client.post("/v1/sessions", content=body, headers=headers)
    assert answer.status_code in {400, 413, 422}
    assert len(answer.content) < 100_000
    assert list(live.settings.spool_dir.iterdir()) == []


def test_tenant_has_some_event_streams_and_others_have_theirs(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings(max_tenant_streams=3)) as live, contextlib.ExitStack() as stack:
        path = f"/v1/jobs/{live.job_id()}/events"
        request = f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
        for _ in range(3):
            stream = stack.enter_context(socket.create_connection(live.address[:2], timeout=180))
            stream.sendall(request)
            received = b""
            while b"event: job" not in received:
                received += stream.recv(65536)
        answer = live.client.get(path)
        assert problem_of(answer, 429, "too_many_streams")["retryable"]
        assert int(answer.headers["retry-after"]) > 0
        with socket.create_connection(live.address[:2], timeout=180, source_address=("127.0.0.2", 0)) as other:
            other.sendall(request)
            assert other.recv(65536).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("level", ["info", "debug"])
def test_long_paths_and_headers_fill_no_log(make_settings: Callable[..., Settings], level: str) -> None:
    settings = make_settings()
    num_requests = 300
    with serving(settings, LOG_LEVEL=level) as (client, process):
        memory = peak_bytes(process)
        log = settings.data_dir.parent / "log"
        before = log.stat().st_size
        for k in range(num_requests // 6):
            client.get(f"/{LONG}")
            client.get(f"/v1/jobs/{LONG}/events")
            client.get(f"/v1/jobs?state={LONG}")
            client.get("/healthz", headers={"User-Agent": LONG, "X-Request-ID": LONG})
            client.get("/v1/jobs", headers={"Authorization": f"Bearer {LONG}"})
            client.post("/v1/sessions", files=form(1, b"CRASH" if k % 10 == 0 else b"WRONG"), headers={"X-Long": LONG})
        assert log.stat().st_size - before < 1000 * num_requests
        assert peak_bytes(process) - memory < 64 * MIB


def test_bad_requests_fill_no_log(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    with serving(settings) as (client, _):
        assert client.base_url.port is not None
        address = (client.base_url.host, client.base_url.port)
        before = (settings.data_dir.parent / "log").stat().st_size
        for _ in range(100):
            raw(address, b"GET /" + LONG.encode() + b" NONSENSE\r\n\r\n")
            upgrade = b"Connection: Upgrade\r\nUpgrade: " + b"x" * 60_000
            raw(address, b"GET / HTTP/1.1\r\nHost: localhost\r\n" + upgrade + b"\r\n\r\n")
        assert (settings.data_dir.parent / "log").stat().st_size - before < 100 * 2000
