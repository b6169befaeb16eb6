"""Sender of webhooks about the ends of jobs, by Standard Webhooks: signed, and never into private networks.

Clients choose the addresses. So a name is resolved once, its addresses are checked, and the connection goes to a
checked address: a name that resolves to another address a moment later (DNS rebinding) has no effect. Redirects are not
followed, proxies of the environment are not used, and each attempt has a time limit.
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

from worker.run.webhooks.addresses import is_public, url_fault
from worker.store.errors import DamagedDatabase
from worker.store.model.job_records import Delivery, WebhookSecret
from worker.store.repositories.webhooks import MAX_TRIES
from worker.store.store import JobStore

log = structlog.get_logger()

_TRY_S = 15.0
_LEASE_S = 4 * _TRY_S
_LOOK_S = 1.0
_AT_ONCE = 16
_AT_ONCE_A_TENANT = 8
_GONE = 410


class RefusedAddressError(Exception):
    """The address is not public."""


def resolve(host: str, port: int, allow_private: bool, timeout_s: float = _TRY_S) -> str:
    """First allowed IP address of a host; raises ``RefusedAddressError`` if there is none."""
    for address in _look_up(host, port, timeout_s):
        if allow_private or is_public(address):
            return address
    raise RefusedAddressError


def _look_up(host: str, port: int, timeout_s: float) -> list[str]:
    """All IP addresses of a host; raises ``TimeoutError`` if its name servers do not answer in time."""
    answer: Future[list[str]] = Future()

    def ask() -> None:
        try:
            answer.set_result([str(info[4][0]) for info in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)])
        except Exception as error:
            answer.set_exception(error)

    # The system's lookup has no time limit; a thread that hangs in it ends by itself later.
    threading.Thread(target=ask, daemon=True).start()
    return answer.result(timeout_s)


class _BoundedStream(httpcore2.NetworkStream):
    """Connection that ends at a deadline, even if the receiver keeps sending slowly."""

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
    """Network backend that connects to checked addresses only."""

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
    """Sends single messages."""

    allow_private: bool  # True if messages may go to addresses of private networks and of this machine, too
    try_s: float = _TRY_S  # Time limit of an attempt

    def send(self, delivery: Delivery, secrets: Sequence[WebhookSecret]) -> str | None:
        """Send a message, signed with all secrets; return a sentence about the failure, or ``None`` on success."""
        if fault := url_fault(delivery.url):
            return fault
        sent_at = datetime.now(UTC)
        signatures = [Webhook(secret.secret).sign(delivery.message_id, sent_at, delivery.body) for secret in secrets]
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
            # Only the status of the response is read.
            with (
                httpcore2.ConnectionPool(network_backend=backend) as pool,
                pool.stream("POST", delivery.url, headers=headers, content=delivery.body.encode()) as response,
            ):
                status = response.status
        except RefusedAddressError:
            return "The address is not public."
        except socket.gaierror:
            return "The name can't be resolved."
        except (httpcore2.TimeoutException, TimeoutError):
            return "The answer took too long."
        except (httpcore2.NetworkError, httpcore2.ProtocolError, OSError) as error:
            log.info("webhook_connection_failed", message=delivery.message_id, error=type(error).__name__)
            return connection_fault(error)
        if 200 <= status < 300 or status == _GONE:
            return None
        return f"It was answered with {status}."


def connection_fault(error: Exception) -> str:
    """Sentence about a failed connection."""
    match error.__context__:
        case ssl.SSLCertVerificationError():
            return "The certificate is not valid for this name."
        case ssl.SSLError():
            return "The TLS handshake failed."
        case _:
            return "The connection failed."


class Courier:
    """Sends due messages, several at a time; a tenant with slow receivers never uses all threads."""

    def __init__(self, store: JobStore, sender: Sender, pool: ThreadPoolExecutor) -> None:
        self._store, self._sender, self._pool = store, sender, pool
        self._running: dict[Future[None], str] = {}

    def start_due(self) -> int:
        """Start to send due messages as far as threads are free; return their number."""
        self._running = {future: tenant for future, tenant in self._running.items() if not future.done()}
        free = _AT_ONCE - len(self._running)
        if free == 0:
            return 0
        busy = Counter(self._running.values())
        due = self._store.webhooks.claim(free, _LEASE_S, _AT_ONCE_A_TENANT, busy)
        for delivery in due:
            self._running[self._pool.submit(_deliver, self._store, self._sender, delivery)] = delivery.tenant
        return len(due)

    def wait(self, timeout_s: float) -> None:
        """Wait until one of the running attempts has ended, or the time is over."""
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
                return  # the reaper ends and reports the damage
            except Exception:
                log.exception("webhooks_failed")
            courier.wait(_LOOK_S)


def _deliver(store: JobStore, sender: Sender, delivery: Delivery) -> None:
    """Attempt once to send a message, and record the outcome."""
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
    except Exception:  # The store failed: the message is due again when its lease ends.
        log.exception("webhook_not_recorded", **known)


def _try(store: JobStore, sender: Sender, delivery: Delivery) -> str | None:
    if delivery.tries > MAX_TRIES:
        return delivery.problem or "No attempt was completed."
    secrets = store.webhook_secrets.valid(delivery.tenant)
    try:
        return sender.send(delivery, secrets)
    except Exception:  # An unrecorded attempt would be repeated without end.
        log.exception("webhook_try_failed", message=delivery.message_id)
        return "The attempt failed; the reaper's log says why."
