"""Connections of clients: limits on their number, and on the time and size of request headers."""

import asyncio
import ipaddress
import time
from collections import Counter, OrderedDict
from collections.abc import Collection
from typing import Any, Protocol

import structlog
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from api.web.http.clients import Network, network_of

_log = structlog.get_logger(__name__)

_MAX_HEAD_BYTES = 64 * 2**10
# Largest rest of a body that is read after its response was sent: most clients read a response only after their body.
_MAX_REST_BYTES = 64 * 2**20
_LOG_EVERY_S = 60.0
_REFUSAL_TEXT = b"Too many connections are open.\n"
_REFUSAL = (
    b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 10\r\nConnection: close\r\nContent-Type: text/plain\r\n"
    b"Content-Length: %d\r\n\r\n%b"
) % (len(_REFUSAL_TEXT), _REFUSAL_TEXT)


class Closable(Protocol):
    """Connection that can be closed."""

    def close(self) -> None:
        """Close the connection soon."""


class Connections:
    """Open connections of a process, in total and by client network.

    A connection is idle while none of its requests is being answered. At the limit of a client, its longest idle
    connection is closed for a new connection; at the limit of the process, the longest idle connection of all clients.
    Without an idle connection the new connection is refused.

    Parameters
    ----------
    max_connections
        Largest number of connections of all clients.
    max_per_client
        Largest number of connections of a client network.
    trusted_proxies
        Networks of proxies. Their connections belong to many clients, so they count in the total only.
    """

    def __init__(self, max_connections: int, max_per_client: int, trusted_proxies: Collection[Network] = ()) -> None:
        self._max_connections, self._max_per_client = max_connections, max_per_client
        self._trusted_proxies = tuple(trusted_proxies)
        self._clients: dict[Closable, str | None] = {}
        self._counts: Counter[str | None] = Counter()
        # Idle connections by client, and of all clients; the longest idle connection comes first.
        self._idle_of: dict[str | None, OrderedDict[Closable, None]] = {}
        self._idle: OrderedDict[Closable, None] = OrderedDict()
        self._log_at_s = 0.0

    def __len__(self) -> int:
        """Number of open connections."""
        return len(self._clients)

    def admit(self, connection: Closable, host: str) -> bool:
        """Count a new, idle connection; return whether it is accepted."""
        client = None if self._is_trusted(host) else network_of(host)
        is_one_too_many = client is not None and self._counts[client] >= self._max_per_client
        room = (
            self._close_idle(self._idle_of.get(client))
            if is_one_too_many
            else len(self._clients) < self._max_connections or self._close_idle(self._idle)
        )
        if not room:
            self._log_refusal(host)
            return False
        self._clients[connection] = client
        self._counts[client] += 1
        self.mark_idle(connection)
        return True

    def mark_busy(self, connection: Closable) -> None:
        """Record that a request of a connection is being answered."""
        if connection in self._clients:
            self._remove_idle(connection)

    def mark_idle(self, connection: Closable) -> None:
        """Record that a connection is idle from now on."""
        if connection in self._clients:
            self._idle[connection] = None
            self._idle_of.setdefault(self._clients[connection], OrderedDict())[connection] = None

    def remove(self, connection: Closable) -> None:
        """Remove a closed connection; a refused connection is unknown and ignored."""
        if connection in self._clients:
            self._remove_idle(connection)
            client = self._clients.pop(connection)
            self._counts[client] -= 1
            if not self._counts[client]:
                del self._counts[client]

    def _close_idle(self, idle: OrderedDict[Closable, None] | None) -> bool:
        """Close the first idle connection; return whether there is an idle connection."""
        if not idle:
            return False
        connection = next(iter(idle))
        self.remove(connection)
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

    def _log_refusal(self, host: str) -> None:
        """Log that connections are refused, at most once a minute."""
        now_s = time.monotonic()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + _LOG_EVERY_S
            _log.warning("connections_refused", client=network_of(host), connections=len(self._clients))


def bounded_protocol(head_s: float, connections: Connections) -> type[HttpToolsProtocol]:
    """Protocol of the HTTP server with limits on connections, request headers and rests of bodies.

    The rest of a body is what a client still sends after its request was answered. ``head_s`` limits the request
    headers, from the connection or from the first byte of a further request to the last header, and the rest of a body.
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
            connections.remove(self)
            self._stop_waiting()
            super().connection_lost(exc)

        def close(self) -> None:
            self.transport.close()

        def data_received(self, data: bytes) -> None:
            if self.transport.is_closing():
                return
            self._num_bytes += len(data)
            super().data_received(data)
            if self.transport.get_protocol() is not self:  # a WebSocket from now on
                return
            # Without a timer the headers are complete: further data belongs to a body and is not limited here.
            if self._timer is not None and self._num_bytes > self._max_bytes:
                self.transport.close()
            elif self._timer is None and self._is_idle():  # empty lines between requests
                self._await(_MAX_HEAD_BYTES)

        def on_message_begin(self) -> None:
            super().on_message_begin()
            if self._timer is None:
                self._await(_MAX_HEAD_BYTES)

        def on_headers_complete(self) -> None:
            self._stop_waiting()
            connections.mark_busy(self)
            super().on_headers_complete()

        def on_message_complete(self) -> None:
            super().on_message_complete()
            if (
                self.cycle is not None and self.cycle.response_complete
            ):  # the rest of an answered request's body has arrived
                self._stop_waiting()
                self._await(_MAX_HEAD_BYTES)

        def on_response_complete(self) -> None:
            super().on_response_complete()
            if not self._is_idle() or self.transport.is_closing():
                return
            connections.mark_idle(self)
            if self.cycle.more_body:
                self._discard_rest()

        def _is_idle(self) -> bool:
            return not self.pipeline and (self.cycle is None or self.cycle.response_complete)

        def _discard_rest(self) -> None:
            """Read the rest of an answered request's body, within limits: the next request begins after it."""
            if self.expect_100_continue:  # the client may or may not send its body now
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
