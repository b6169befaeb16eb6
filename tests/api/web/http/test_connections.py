"""Idle connections: their number is limited, and other clients are served."""

import contextlib
import re
import socket
import time
from collections.abc import Callable, Iterator
from ipaddress import ip_network

import httpx2
import psutil
import pytest

from api.web.http.connections import Connections
from api.web.settings import Settings
from tests.api.conftest import Live, running
from tests.api.processes import serving

REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


def connect(address: tuple[str, int], source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(address, timeout=30, source_address=(source, 0))


def address_of(client: httpx2.Client) -> tuple[str, int]:
    assert client.base_url.port is not None
    return client.base_url.host, client.base_url.port


@contextlib.contextmanager
def idle_sockets(address: tuple[str, int], count: int, sources: list[str]) -> Iterator[list[socket.socket]]:
    """Open silent sockets from several addresses in turn."""
    with contextlib.ExitStack() as stack:
        yield [
            stack.enter_context(contextlib.closing(connect(address, sources[k % len(sources)]))) for k in range(count)
        ]


def is_closed(connection: socket.socket) -> bool:
    connection.settimeout(0.05)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def ask(connection: socket.socket) -> bytes:
    """Send a request; return the first line of the response."""
    connection.sendall(REQUEST)
    return connection.recv(65536).split(b"\r\n")[0]


def test_a_client_s_idle_sockets_keep_nobody_out(make_settings: Callable[..., Settings]) -> None:
    """The process starts with a low soft limit on open files, which is common."""
    settings = make_settings()
    with serving(settings, descriptors=1024) as (client, process):
        soft, hard = process.rlimit(psutil.RLIMIT_NOFILE)
        assert soft == min(hard, 65_536)
        address = address_of(client)
        with idle_sockets(address, 1300, ["127.0.0.1"]), contextlib.closing(connect(address, "127.0.0.2")) as other:
            assert ask(other) == b"HTTP/1.1 200 OK"
            assert process.num_fds() < 900
            assert client.get("/healthz").status_code == 200  # an idle connection of the same address was closed for it


def test_idle_sockets_of_many_clients_keep_nobody_out(make_settings: Callable[..., Settings]) -> None:
    with serving(make_settings(), MAX_CONNECTIONS="100") as (client, process):
        address = address_of(client)
        sources = [f"127.0.1.{k}" for k in range(1, 61)]
        with idle_sockets(address, 240, sources), contextlib.closing(connect(address, "127.0.0.2")) as other:
            assert ask(other) == b"HTTP/1.1 200 OK"
            assert process.num_fds() < 200


def test_the_service_goes_on_once_it_may_open_files_again(make_settings: Callable[..., Settings]) -> None:
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
    with running(make_settings(max_client_connections=4, client_idle_s=20.0)) as live:
        yield live


def test_the_connection_that_was_idle_for_longest_goes_first(few: Live) -> None:
    with idle_sockets(few.address, 4, ["127.0.0.3"]) as idle:
        assert ask(idle[0]) == b"HTTP/1.1 200 OK"  # idle from now on
        with contextlib.closing(connect(few.address, "127.0.0.3")) as fifth:
            assert ask(fifth) == b"HTTP/1.1 200 OK"
        assert [is_closed(one) for one in idle] == [False, True, False, False]


def test_idle_connections_outlast_those_of_clients(few: Live) -> None:
    """httpx closes connections that were idle for 5 s: closed at the same moment here, its next request would fail."""
    with contextlib.closing(connect(few.address, "127.0.0.6")) as connection:
        assert ask(connection) == b"HTTP/1.1 200 OK"
        time.sleep(6)
        assert ask(connection) == b"HTTP/1.1 200 OK"


def test_connections_that_are_at_work_stay_and_one_more_is_refused(few: Live) -> None:
    job_id = few.job_id()
    follow = f"GET /v1/jobs/{job_id}/events HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
    with idle_sockets(few.address, 4, ["127.0.0.4"]) as streams:
        for stream in streams:
            stream.sendall(follow)
            assert stream.recv(65536).startswith(b"HTTP/1.1 200 OK")
        with contextlib.closing(connect(few.address, "127.0.0.4")) as fifth:
            refusal = fifth.recv(65536)
            assert refusal.startswith(b"HTTP/1.1 429 ")
            assert re.search(rb"Retry-After: \d+\r\n", refusal)
            assert is_closed(fifth)
        with contextlib.closing(connect(few.address, "127.0.0.5")) as other:
            assert ask(other) == b"HTTP/1.1 200 OK"
        assert not any(is_closed(stream) for stream in streams)
    deadline_s = time.monotonic() + 120
    while True:  # closed connections are no longer counted
        with contextlib.closing(connect(few.address, "127.0.0.4")) as again:
            if ask(again) == b"HTTP/1.1 200 OK":
                break
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


class Fake:
    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


def test_addresses_of_an_ipv6_network_are_one_client() -> None:
    connections = Connections(100, 2)
    first, second, third, other = Fake(), Fake(), Fake(), Fake()
    assert connections.admit(first, "2001:db8:0:1::1")
    assert connections.admit(second, "2001:db8:0:1:ffff::2")
    connections.mark_busy(second)
    assert connections.admit(third, "2001:db8:0:1::3")
    assert (first.closed, second.closed) == (True, False)
    connections.mark_busy(third)
    assert not connections.admit(Fake(), "2001:db8:0:1::4")
    assert connections.admit(other, "2001:db8:0:2::1")
    assert len(connections) == 3


def test_connections_of_a_trusted_proxy_count_in_the_sum_only() -> None:
    connections = Connections(3, 1, [ip_network("10.0.0.0/8")])
    fakes = [Fake() for _ in range(4)]
    assert all(connections.admit(fake, "10.1.2.3") for fake in fakes)
    assert [fake.closed for fake in fakes] == [True, False, False, False]
    for fake in fakes[1:]:
        connections.mark_busy(fake)
    assert not connections.admit(Fake(), "192.0.2.1")
    connections.remove(fakes[1])
    assert connections.admit(Fake(), "192.0.2.1")


@pytest.mark.parametrize("after", [b"", b"\r\n", b"\r\nGET"])
def test_connections_that_begin_no_further_request_are_closed(
    make_settings: Callable[..., Settings], after: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.web.http.server._KEEP_ALIVE_S", 2)
    with (
        running(make_settings(client_idle_s=1.0)) as live,
        contextlib.closing(connect(live.address)) as connection,
    ):
        assert ask(connection) == b"HTTP/1.1 200 OK"
        connection.sendall(after)
        connection.settimeout(30)
        assert connection.recv(1) == b""
