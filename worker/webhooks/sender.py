"""Sender of webhooks about jobs' ends, by Standard Webhooks: signed, small, and never into private networks.

Clients choose the address, so it may be hostile. A name is resolved once, the resolved address is checked, and the
connection is made to that address: a name that resolves to another address a moment later (DNS rebinding) changes
nothing. Redirects are not followed, no proxy of the environment is used, and each try has a time limit.
"""

import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlsplit

import httpcore2
import structlog
from standardwebhooks import Webhook

from worker.jobs.errors import DamagedDatabase
from worker.jobs.model import Delivery, WebhookSecret
from worker.jobs.repositories.webhooks import MAX_TRIES
from worker.jobs.store import JobStore
from worker.webhooks.addresses import is_public, url_fault

log = structlog.get_logger()

_TRY_S = 15.0
_LEASE_S = 4 * _TRY_S
_LOOK_S = 1.0
_AT_ONCE = 16
_AT_ONCE_A_TENANT = 8
_GONE = 410


class _RefusedError(Exception):
    """No message may be sent to the address."""


def resolve(host: str, port: int, allow_private: bool, timeout_s: float = _TRY_S) -> str:
    """First address of a host that a message may be sent to; raises if there is none."""
    for address in _look_up(host, port, timeout_s):
        if allow_private or is_public(address):
            return address
    raise _RefusedError


def _look_up(host: str, port: int, timeout_s: float) -> list[str]:
    """All addresses of a host; ``TimeoutError`` if its name servers are slow."""
    answer: Future[list[str]] = Future()

    def ask() -> None:
        try:
            answer.set_result([str(info[4][0]) for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)])
        except Exception as error:
            answer.set_exception(error)

    # The look-up of the system has no time limit; a thread that hangs in it ends by itself later.
    threading.Thread(target=ask, daemon=True).start()
    return answer.result(timeout_s)


class _BoundedStream(httpcore2.NetworkStream):
    """Connection that ends at a deadline, however slowly the other side sends."""

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
    """Backend that connects to the address that it has checked."""

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
        address = resolve(host, port, self._allow_private, self._try_s)
        left_s = max(deadline_s - time.monotonic(), 0.001)
        stream = self._backend.connect_tcp(address, port, left_s, local_address, socket_options)
        return _BoundedStream(stream, deadline_s)


@dataclass(frozen=True, slots=True)
class Sender:
    """Sends messages.

    Parameters
    ----------
    allow_private
        Whether messages may be sent to private networks and to this machine.
    try_s
        Time limit of a try.
    """

    allow_private: bool
    try_s: float = _TRY_S

    def send(self, delivery: Delivery, secrets: Sequence[WebhookSecret]) -> str | None:
        """Send a message, signed with all secrets; returns the problem, or ``None`` if the message is done."""
        if fault := url_fault(delivery.url):
            return fault
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
        return self._post(delivery, headers)

    def _post(self, delivery: Delivery, headers: dict[bytes | str, bytes | str]) -> str | None:
        backend = _CheckedBackend(self.allow_private, self.try_s)
        try:
            # Only the status of the response is of interest; the rest is not read.
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
            return _connection_fault(error)
        if 200 <= status < 300 or status == _GONE:
            return None
        return f"It was answered with {status}."


def _connection_fault(error: Exception) -> str:
    match error.__context__:
        case ssl.SSLCertVerificationError():
            return "The certificate is not valid for this name."
        case ssl.SSLError():
            return "The TLS handshake failed."
        case _:
            return "The connection failed."


class Courier:
    """Sends due messages, several at a time; slow receivers of one tenant leave places to the other tenants."""

    def __init__(self, store: JobStore, sender: Sender, pool: ThreadPoolExecutor) -> None:
        self._store, self._sender, self._pool = store, sender, pool
        self._running: dict[Future[None], str] = {}

    def start_due(self) -> int:
        """Begin to send due messages while there are places; returns their number."""
        self._running = {one: tenant for one, tenant in self._running.items() if not one.done()}
        free = _AT_ONCE - len(self._running)
        if free == 0:
            return 0
        busy = Counter(self._running.values())
        due = self._store.webhooks.claim(free, _LEASE_S, _AT_ONCE_A_TENANT, busy)
        for delivery in due:
            self._running[self._pool.submit(_deliver, self._store, self._sender, delivery)] = delivery.tenant
        return len(due)

    def wait(self, timeout_s: float) -> None:
        """Wait until the try of a message has ended, or the time is over."""
        if self._running:
            wait(self._running, timeout_s, FIRST_COMPLETED)
        else:
            time.sleep(timeout_s)


def deliver_forever(store: JobStore, sender: Sender) -> None:
    """Send due messages until the database is damaged."""
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        courier = Courier(store, sender, pool)
        while True:
            try:
                courier.start_due()
            except DamagedDatabase:
                return  # the reaper ends with the message
            except Exception:
                log.exception("webhooks_failed")
            courier.wait(_LOOK_S)


def _deliver(store: JobStore, sender: Sender, delivery: Delivery) -> None:
    """Try once, and record the outcome."""
    known = {"message": delivery.message_id, "job": delivery.job_id, "tries": delivery.tries}
    try:
        problem = _try(store, sender, delivery)
        if problem is None:
            store.webhooks.delivered(delivery)
            log.info("webhook_delivered", **known)
        elif store.webhooks.failed(delivery, problem):
            log.warning("webhook_not_delivered", problem=problem, **known)
        else:
            log.error("webhook_given_up", problem=problem, **known)
    except Exception:  # of the store: the message is due again when its lease ends
        log.exception("webhook_not_recorded", **known)


def _try(store: JobStore, sender: Sender, delivery: Delivery) -> str | None:
    if delivery.tries > MAX_TRIES:
        return delivery.problem or "No try came to its end."
    secrets = store.webhook_secrets.valid(delivery.tenant)
    try:
        return sender.send(delivery, secrets)
    except Exception:  # counts as a try: without a record the message would be tried for ever
        log.exception("webhook_try_failed", message=delivery.message_id)
        return "The try failed; the reaper's log says why."
