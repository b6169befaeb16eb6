"""Connections of clients: how many there may be, and an end to those whose requests never begin in earnest."""

import asyncio
import ipaddress
import time
from collections import Counter, OrderedDict
from collections.abc import Collection
from typing import Any, Protocol

import structlog
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from api.http.clients import Network, network_of

_log = structlog.get_logger(__name__)

_MAX_HEAD_BYTES = 64 * 2**10
# Of a body whose request was answered before all of it had come: most clients read the answer only after their body.
_MAX_REST_BYTES = 64 * 2**20
_LOG_EVERY_S = 60.0
_REFUSAL_TEXT = b"Too many connections are open.\n"
_REFUSAL = (
    b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 10\r\nConnection: close\r\nContent-Type: text/plain\r\n"
    b"Content-Length: %d\r\n\r\n%b"
) % (len(_REFUSAL_TEXT), _REFUSAL_TEXT)


class Closable(Protocol):
    """A connection."""

    def close(self) -> None:
        """Close it soon."""


class Connections:
    """Open connections of a process, all in all and by client network.

    A connection is idle while none of its requests is being answered. Where one connection is too many, an idle one
    goes: of the same client, or of all clients the one that was idle for longest. Without an idle one the new
    connection is refused.

    Parameters
    ----------
    max_connections
        Of all clients.
    max_per_client
        Of one client network.
    trusted_proxies
        Networks of proxies, whose connections are those of many clients: they count in the sum only.
    """

    def __init__(self, max_connections: int, max_per_client: int, trusted_proxies: Collection[Network] = ()) -> None:
        self._max_connections, self._max_per_client = max_connections, max_per_client
        self._trusted_proxies = tuple(trusted_proxies)
        self._clients: dict[Closable, str | None] = {}
        self._counts: Counter[str | None] = Counter()
        # By client, and of all; the one that was idle for longest comes first.
        self._idle_of: dict[str | None, OrderedDict[Closable, None]] = {}
        self._idle: OrderedDict[Closable, None] = OrderedDict()
        self._log_at_s = 0.0

    def __len__(self) -> int:
        """How many there are."""
        return len(self._clients)

    def admit(self, connection: Closable, host: str) -> bool:
        """Count a new connection, which is idle; returns false if it is to be refused."""
        client = None if self._is_trusted(host) else network_of(host)
        is_one_too_many = client is not None and self._counts[client] >= self._max_per_client
        room = (
            self._close_idle(self._idle_of.get(client))
            if is_one_too_many
            else len(self._clients) < self._max_connections or self._close_idle(self._idle)
        )
        if not room:
            self._tell(host)
            return False
        self._clients[connection] = client
        self._counts[client] += 1
        self.rest(connection)
        return True

    def work(self, connection: Closable) -> None:
        """Note that a request of a connection is being answered."""
        if connection in self._clients:
            self._remove_idle(connection)

    def rest(self, connection: Closable) -> None:
        """Note that a connection is idle from now on."""
        if connection in self._clients:
            self._idle[connection] = None
            self._idle_of.setdefault(self._clients[connection], OrderedDict())[connection] = None

    def forget(self, connection: Closable) -> None:
        """Forget a connection that is closed; one that is unknown is none."""
        if connection in self._clients:
            self._remove_idle(connection)
            client = self._clients.pop(connection)
            self._counts[client] -= 1
            if not self._counts[client]:
                del self._counts[client]

    def _close_idle(self, idle: OrderedDict[Closable, None] | None) -> bool:
        """Close the first of some idle connections; returns whether there was one."""
        if not idle:
            return False
        connection = next(iter(idle))
        self.forget(connection)
        connection.close()
        return True

    def _remove_idle(self, connection: Closable) -> None:
        if connection in self._idle:
            del self._idle[connection]
            client = self._clients[connection]
            del self._idle_of[client][connection]
            if not self._idle_of[client]:
                del self._idle_of[client]

    def _is_trusted(self, host: str) -> bool:
        if not self._trusted_proxies:
            return False
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            return False
        return any(address in network for network in self._trusted_proxies)

    def _tell(self, host: str) -> None:
        """Log that connections are refused, now and then."""
        now_s = time.monotonic()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + _LOG_EVERY_S
            _log.warning("connections_refused", client=network_of(host), connections=len(self._clients))


def bounded_protocol(head_s: float, connections: Connections) -> type[HttpToolsProtocol]:
    """The server's protocol, with limits on connections, heads of requests, and bodies that come after their answers.

    Parameters
    ----------
    head_s
        How long a head may take: from the connection on, or from the first byte of a further request, until the last
        header. Also how long the rest of a body may take whose request was answered.
    connections
        All connections of this process.
    """

    class BoundedProtocol(HttpToolsProtocol):
        _num_bytes = 0
        _max_bytes = 0
        _timer: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            if connections.admit(self, self.client[0] if self.client else "unknown"):
                self._await(_MAX_HEAD_BYTES)
            else:
                transport.write(_REFUSAL)
                transport.close()

        def connection_lost(self, exc: Exception | None) -> None:
            connections.forget(self)
            self._stop_waiting()
            super().connection_lost(exc)

        def close(self) -> None:
            self.transport.close()

        def data_received(self, data: bytes) -> None:
            if self.transport.is_closing():
                return
            self._num_bytes += len(data)
            super().data_received(data)
            # What is left of the data after a head's end is a body's; then nobody waits for the head any more.
            if self._timer is not None and self._num_bytes > self._max_bytes:
                self.transport.close()
            elif self._timer is None and self._is_idle():  # empty lines, which begin no request
                self._await(_MAX_HEAD_BYTES)

        def on_message_begin(self) -> None:
            super().on_message_begin()
            if self._timer is None:
                self._await(_MAX_HEAD_BYTES)

        def on_headers_complete(self) -> None:
            self._stop_waiting()
            connections.work(self)
            super().on_headers_complete()

        def on_message_complete(self) -> None:
            super().on_message_complete()
            if self.cycle.response_complete:  # the rest of an answered request's body has come
                self._stop_waiting()
                self._await(_MAX_HEAD_BYTES)

        def on_response_complete(self) -> None:
            super().on_response_complete()
            if not self._is_idle() or self.transport.is_closing():
                return
            connections.rest(self)
            if self.cycle.more_body:
                self._discard_rest()

        def _is_idle(self) -> bool:
            return not self.pipeline and (self.cycle is None or self.cycle.response_complete)

        def _discard_rest(self) -> None:
            """Take the rest of an answered request's body, within limits, so that the next request can be found."""
            if self.expect_100_continue:  # nobody can say whether the client still sends its body
                self.transport.close()
            else:
                self._await(_MAX_REST_BYTES)

        def _await(self, max_bytes: int) -> None:
            self._num_bytes, self._max_bytes = 0, max_bytes
            self._timer = self.loop.call_later(head_s, self.transport.close)

        def _stop_waiting(self) -> None:
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None

    return BoundedProtocol
