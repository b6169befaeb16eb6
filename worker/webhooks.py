"""Tell clients of their jobs' ends, by Standard Webhooks: signed, small, and never into networks of our own.

A stranger chooses the address. So a name is resolved once, what it resolves to is checked, and that very address is
connected to: a name that resolves to another one a moment later (DNS rebinding) changes nothing. Redirects are not
followed, no proxy of the environment is used, and each try has an end.
"""

import socket
import ssl
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import httpcore2
import structlog
from standardwebhooks import Webhook

from worker.addresses import is_public
from worker.jobs.model import Delivery, WebhookSecret
from worker.jobs.store import JobStore

log = structlog.get_logger()

_TRY_S = 15.0
_LEASE_S = 4 * _TRY_S
_LOOK_S = 1.0
_AT_ONCE = 8
_GONE = 410


class _RefusedError(Exception):
    """The address is none that a message may go to."""


def resolve(host: str, port: int, allow_private: bool) -> str:
    """The first address of a host that a message may go to; raises if there is none."""
    found = [str(info[4][0]) for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)]
    for address in found:
        if allow_private or is_public(address.partition("%")[0]):
            return address
    raise _RefusedError


class _BoundedStream(httpcore2.NetworkStream):
    """A connection that ends at a moment, however slowly the other side goes on."""

    def __init__(self, stream: httpcore2.NetworkStream, deadline_s: float) -> None:
        self._stream, self._deadline_s = stream, deadline_s

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, self._left_s())

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self._stream.write(buffer, self._left_s())

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore2.NetworkStream:
        return _BoundedStream(self._stream.start_tls(ssl_context, server_hostname, self._left_s()), self._deadline_s)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)

    def _left_s(self) -> float:
        left_s = self._deadline_s - time.monotonic()
        if left_s <= 0:
            raise httpcore2.ReadTimeout
        return left_s


class _CheckedBackend(httpcore2.NetworkBackend):
    """Connects to what it has checked."""

    def __init__(self, allow_private: bool, try_s: float) -> None:
        self._allow_private, self._try_s = allow_private, try_s
        self._backend = httpcore2.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore2.NetworkStream:
        deadline_s = time.monotonic() + self._try_s
        address = resolve(host, port, self._allow_private)
        stream = self._backend.connect_tcp(address, port, self._try_s, local_address, socket_options)
        return _BoundedStream(stream, deadline_s)


@dataclass(frozen=True, slots=True)
class Sender:
    """Sends messages.

    Parameters
    ----------
    allow_private
        Whether they may go to addresses of private networks and of this machine, too.
    try_s
        How long a try may take.
    """

    allow_private: bool
    try_s: float = _TRY_S

    def send(self, delivery: Delivery, secrets: Sequence[WebhookSecret]) -> str | None:
        """Send a message, signed with all secrets; what went wrong, or ``None`` if it is done with."""
        sent_at = datetime.now(UTC)
        signatures = [Webhook(one.secret).sign(delivery.message_id, sent_at, delivery.body) for one in secrets]
        headers: dict[bytes | str, bytes | str] = {
            "Host": urlsplit(delivery.url).netloc,
            "Content-Type": "application/json",
            "User-Agent": "Multicap-Webhooks/1",
            "webhook-id": delivery.message_id,
            "webhook-timestamp": str(int(sent_at.timestamp())),
            "webhook-signature": " ".join(signatures),
        }
        backend = _CheckedBackend(self.allow_private, self.try_s)
        try:
            # Of what is answered only the status is of interest; the rest is not read.
            with (
                httpcore2.ConnectionPool(network_backend=backend) as pool,
                pool.stream("POST", delivery.url, headers=headers, content=delivery.body.encode()) as response,
            ):
                status = response.status
        except _RefusedError:
            return "The address is not public."
        except socket.gaierror:
            return "The name can't be resolved."
        except (httpcore2.TimeoutException, TimeoutError):
            return "The answer took too long."
        except (httpcore2.NetworkError, httpcore2.ProtocolError, OSError) as error:
            log.info("webhook_connection_failed", message=delivery.message_id, error=type(error).__name__)
            return "The connection failed."
        if 200 <= status < 300 or status == _GONE:
            return None
        return f"It was answered with {status}."


def deliver_due(store: JobStore, sender: Sender, pool: ThreadPoolExecutor) -> int:
    """Send what is due; returns how much there was."""
    due = store.claim_deliveries(_AT_ONCE, _LEASE_S)
    list(pool.map(lambda delivery: _deliver(store, sender, delivery), due))
    return len(due)


def deliver_forever(store: JobStore, sender: Sender) -> None:
    """Send what is due, whenever there is something."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        while True:
            try:
                num_sent = deliver_due(store, sender, pool)
            except Exception:
                log.exception("webhooks_failed")
                num_sent = 0
            if num_sent == 0:
                time.sleep(_LOOK_S)


def _deliver(store: JobStore, sender: Sender, delivery: Delivery) -> None:
    known = {"message": delivery.message_id, "job": delivery.job_id, "tries": delivery.tries}
    problem = sender.send(delivery, store.webhook_secrets(delivery.tenant))
    if problem is None:
        store.delivered(delivery)
        log.info("webhook_delivered", **known)
    elif store.not_delivered(delivery, problem):
        log.warning("webhook_not_delivered", problem=problem, **known)
    else:
        log.error("webhook_given_up", problem=problem, **known)
