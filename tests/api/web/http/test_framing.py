"""Framing: requests and responses of one connection stay separate, whatever a client sends."""

import contextlib
import re
import socket
from collections.abc import Callable, Iterator

import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, running

HEALTH = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
WAIT_S = 30.0


@pytest.fixture(scope="module")
def small(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings(client_idle_s=2.0)) as live:
        yield live


def request(method: str, path: str, body: bytes = b"", **headers: str) -> bytes:
    named = {"Host": "localhost", "Content-Length": str(len(body)), "Tus-Resumable": "1.0.0"}
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in (named | headers).items()), "", ""]
    return "\r\n".join(lines).replace("_", "-").encode() + body


class Connection:
    """Connection that reads each response by its headers."""

    def __init__(self, live: Live) -> None:
        self._socket = socket.create_connection(live.address[:2], timeout=WAIT_S)
        self._read = b""

    def __enter__(self) -> "Connection":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def answer(self, *, has_body: bool = True) -> tuple[int, bytes]:
        """Status and body of the next response."""
        while b"\r\n\r\n" not in self._read:
            self._more()
        head, _, self._read = self._read.partition(b"\r\n\r\n")
        found = re.search(rb"(?i)content-length: (\d+)", head)
        length = int(found[1]) if found and has_body else 0
        while len(self._read) < length:
            self._more()
        body, self._read = self._read[:length], self._read[length:]
        return int(head.split()[1]), body

    def is_closed(self) -> bool:
        with contextlib.suppress(ConnectionResetError):
            return self._socket.recv(1) == b""
        return True

    def _more(self) -> None:
        block = self._socket.recv(65536)
        assert block, self._read
        self._read += block


def upload(live: Live) -> str:
    headers = {"Upload-Length": "4", "Upload-Metadata": "filename Y2FtXzAubXA0", "Tus-Resumable": "1.0.0"}
    return str(live.client.post("/v1/uploads", headers=headers).headers["location"])


@pytest.mark.parametrize("body", [b"", b"x" * 500, HEALTH])
@pytest.mark.parametrize("method", ["HEAD", "PATCH", "DELETE", "GET", "OPTIONS", "PUT"])
@pytest.mark.parametrize("path", ["an upload", "/v1/uploads/unknown", "/v1/uploads", "/v1/uploadsandmore"])
def test_methods_by_another_name_leave_nothing_on_connection(small: Live, path: str, method: str, body: bytes) -> None:
    address = upload(small) if path == "an upload" else path
    with Connection(small) as connection:
        connection.send(request("POST", address, body, X_HTTP_Method_Override=method) + HEALTH)
        status, _ = connection.answer()
        assert status < 500
        assert connection.answer() == (200, small.client.get("/healthz").content)


def test_offset_can_be_asked_for_by_post(small: Live) -> None:
    headers = {"Tus-Resumable": "1.0.0", "X-HTTP-Method-Override": "HEAD"}
    answer = small.client.post(upload(small), headers=headers)
    assert (answer.status_code, answer.headers["upload-offset"], answer.content) == (200, "0", b"")
    # A response to POST has a body with the problem.
    assert small.client.post("/v1/uploads/unknown", headers=headers).json()["code"] == "not_found"


@pytest.mark.parametrize(
    "first",
    [
        request("POST", "/nowhere", b"x" * 100_000),
        request("POST", "/v1/jobs", b"x" * 100_000, Content_Type="text/plain"),
        request("DELETE", "/healthz", HEALTH),
        request("GET", "/healthz", HEALTH),
        request("HEAD", "/healthz"),
        b"POST /nowhere HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n0\r\n\r\n",
    ],
)
def test_unread_rest_of_body_is_not_request(small: Live, first: bytes) -> None:
    with Connection(small) as connection:
        connection.send(first)
        connection.answer(has_body=not first.startswith(b"HEAD"))
        connection.send(HEALTH)
        assert connection.answer() == (200, small.client.get("/healthz").content)


@pytest.mark.parametrize(
    "head",
    [
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"POST /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\nhello",
        b"POST /healthz HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n\r\n",
        b"POST /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: +5\r\n\r\nhello",
        b"GET /healthz HTTP/1.1\nHost: localhost\nContent-Length : 5\n\nhello",
    ],
)
def test_ambiguous_lengths_are_refused(small: Live, head: bytes) -> None:
    with Connection(small) as connection:
        connection.send(head)
        assert connection.answer()[0] == 400
        assert connection.is_closed()
