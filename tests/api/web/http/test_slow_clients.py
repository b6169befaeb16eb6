"""Slow clients: they stop sending or receiving, or send a few bytes at a time."""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from api.web.settings import MIB, Settings
from tests.api.conftest import Live, form, running

IDLE_S = 1.0


@pytest.fixture(scope="module")
def strict(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings(client_idle_s=IDLE_S, client_min_bytes_per_s=500.0)) as live:
        yield live


def head(path: str, length: int, content_type: str = "multipart/form-data; boundary=x") -> bytes:
    lines = [f"POST {path} HTTP/1.1", "Host: localhost", f"Content-Type: {content_type}", f"Content-Length: {length}"]
    return "\r\n".join([*lines, "", ""]).encode()


def answer_of(connection: socket.socket) -> bytes:
    """All bytes until the service closes the connection."""
    received = b""
    while block := connection.recv(65536):
        received += block
    return received


@pytest.mark.parametrize(
    ("path", "content_type"),
    [("/v1/sessions", "multipart/form-data; boundary=x"), ("/v1/browser-session", "application/json")],
)
def test_client_that_stops_sending_is_disconnected(strict: Live, path: str, content_type: str) -> None:
    with socket.create_connection(strict.address[:2], timeout=30) as connection:
        connection.sendall(head(path, 900, content_type) + b"--x\r\n")
        answer = answer_of(connection)
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"client_too_slow" in answer
    assert strict.kept() == []


def test_client_that_sends_too_slowly_is_disconnected(strict: Live) -> None:
    with socket.create_connection(strict.address[:2], timeout=30) as connection:
        connection.sendall(head("/v1/sessions", 90_000) + b"--x\r\n")
        connection.settimeout(0.1)
        deadline_s = time.monotonic() + 120
        answer = b""
        while not answer:
            assert time.monotonic() < deadline_s
            connection.sendall(b"x")
            try:
                answer = connection.recv(65536)
            except TimeoutError:
                continue
    assert answer.startswith(b"HTTP/1.1 408 ")


def test_slow_and_steady_client_is_served(strict: Live) -> None:
    sized = strict.client.build_request("POST", "/v1/sessions", files=form(1, b"v" * 40_000))
    body = sized.read()

    def slowly() -> Iterator[bytes]:
        for start in range(0, len(body), 10_000):
            time.sleep(IDLE_S / 2)
            yield body[start : start + 10_000]

    headers = {"Content-Type": sized.headers["content-type"]}
    assert strict.client.post("/v1/sessions", content=slowly(), headers=headers).status_code == 201


def test_client_that_receives_nothing_is_disconnected(strict: Live) -> None:
    content = b"B" * (64 * MIB)  # more than all network buffers hold
    job_id = strict.job_id()
    strict.finish(job_id, content)
    request = f"GET /v1/jobs/{job_id}/results/person-1.bvh HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with socket.create_connection(strict.address[:2], timeout=30) as connection:
        connection.sendall(request.encode())
        time.sleep(3 * IDLE_S)
        received = 0
        try:
            while block := connection.recv(2**20):
                received += len(block)
        except ConnectionResetError:
            pass
    assert 0 < received < len(content)
    assert len(strict.client.get(f"/v1/jobs/{job_id}/results/person-1.bvh").content) == len(content)


def test_client_of_event_stream_is_not_slow(strict: Live) -> None:
    job_id = strict.job_id()
    with strict.client.stream("GET", f"/v1/jobs/{job_id}/events") as events:
        lines = events.iter_lines()
        assert next(lines)
        time.sleep(2 * IDLE_S)
        strict.client.post(f"/v1/jobs/{job_id}/cancel").raise_for_status()
        assert any('"state":"canceled"' in line.replace(" ", "") for line in lines)


def test_endless_headers_are_cut(strict: Live) -> None:
    with socket.create_connection(strict.address[:2], timeout=30) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(b"GET /v1/jobs HTTP/1.1\r\nX-Endless: ")
        for _ in range(1000):
            connection.sendall(b"x" * 2**14)
            time.sleep(0.01)
        pytest.fail("the headers had no end")


def test_large_bodies_are_no_large_heads(strict: Live) -> None:
    assert strict.client.post("/v1/sessions", files=form(2, b"v" * 90_000)).status_code == 201
