"""Open connections: their number is limited, and idle ones stay open for their clients."""

import contextlib
import socket
import time
from collections.abc import Callable, Iterator

import httpx2
import psutil
import pytest

from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.processes import serving
from tests.waiting import wait_for

REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


def connect(address: tuple[str, int], source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(address, timeout=30, source_address=(source, 0))


def address_of(client: httpx2.Client) -> tuple[str, int]:
    assert client.base_url.port is not None
    return client.base_url.host, client.base_url.port


def ask(connection: socket.socket) -> bytes:
    """Send a request; return the first line of the response."""
    connection.sendall(REQUEST)
    return connection.recv(65536).split(b"\r\n")[0]


def test_service_answers_again_once_it_may_open_files(make_settings: Callable[..., Settings]) -> None:
    """There are more connections than descriptors, because the limit of the running service was lowered."""
    with serving(make_settings()) as (client, process):
        client.get("/healthz").raise_for_status()
        address = address_of(client)
        _, hard = process.rlimit(psutil.RLIMIT_NOFILE)
        process.rlimit(psutil.RLIMIT_NOFILE, (process.num_fds() + 5, hard))
        with contextlib.ExitStack() as stack:
            for _ in range(40):
                with contextlib.suppress(OSError):
                    stack.enter_context(contextlib.closing(connect(address)))
            time.sleep(0.5)
            assert process.is_running()
        deadline_s = time.monotonic() + 120
        while True:
            with contextlib.suppress(httpx2.TransportError):
                if client.get("/healthz").status_code == 200:
                    break
            assert time.monotonic() < deadline_s
            time.sleep(0.1)


@pytest.fixture(scope="module")
def few(make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with running(make_settings(max_connections=4)) as live:
        yield live


def test_idle_connections_outlast_their_clients(few: Live) -> None:
    """httpx closes connections that were idle for 5 s: closed at the same moment here, its next request would fail."""
    with contextlib.closing(connect(few.address, "127.0.0.6")) as connection:
        assert ask(connection) == b"HTTP/1.1 200 OK"
        time.sleep(6)
        assert ask(connection) == b"HTTP/1.1 200 OK"


def test_requests_beyond_connections_are_refused(few: Live) -> None:
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            stack.enter_context(contextlib.closing(connect(few.address)))
        with contextlib.closing(connect(few.address)) as last:
            assert ask(last) == b"HTTP/1.1 503 Service Unavailable"
    wait_for(lambda: few.client.get("/healthz").status_code == 200)
