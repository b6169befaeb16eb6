"""Webhooks: what arrives, what is tried again, and where nothing ever goes."""

import contextlib
import itertools
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpcore2
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from standardwebhooks import Webhook
from standardwebhooks.webhooks import WebhookVerificationError

from api.schemas import JobEnded
from tests.worker.conftest import Bench
from worker import webhooks
from worker.addresses import is_public
from worker.jobs.model import Delivery, Job, WebhookSecret
from worker.jobs.spec import JobSpec
from worker.jobs.tables import deliveries
from worker.plan import plan
from worker.webhooks import Sender, deliver_due

HOUR_S = 3600.0


@dataclass
class Receiver:
    """A client's server."""

    port: int
    statuses: list[int] = field(default_factory=list)  # of the next answers; then 204
    received: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    paths: list[str] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/hook?x=1"


@contextlib.contextmanager
def receiving(context: ssl.SSLContext | None = None) -> Iterator[Receiver]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            found.received.append(({name.lower(): value for name, value in self.headers.items()}, body))
            found.paths.append(self.path)
            self.send_response(found.statuses.pop(0) if found.statuses else 204)
            self.send_header("Location", "/elsewhere")
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        found = Receiver(server.server_address[1])
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield found
        server.shutdown()
        thread.join()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as found:
        yield found


def certify(folder: Path, name: str) -> tuple[Path, Path]:
    """A certificate of a host that it has signed itself, and its key."""
    key, subject = ec.generate_private_key(ec.SECP256R1()), x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now, day = datetime.now(UTC), timedelta(days=1)
    certificate = (
        x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number(), now - day, now + day)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .sign(key, hashes.SHA256())
    )
    plain = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "key.pem").write_bytes(key.private_bytes(*plain))
    (folder / "certificate.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    return folder / "certificate.pem", folder / "key.pem"


def end_job(bench: Bench, url: str) -> Job:
    """Have a job come to its end that somebody wants to be told of."""
    spec = JobSpec(callback_url=url)
    job = bench.store.create_job(bench.session.id, spec, plan(bench.session, spec, 1000))
    bench.runner().work(60.0)
    return bench.store.job(job.id)


def deliver(bench: Bench, sender: Sender | None = None) -> int:
    with ThreadPoolExecutor(4) as pool:
        return deliver_due(bench.store, sender or Sender(allow_private=True), pool)


def make_due(bench: Bench) -> None:
    with bench.store._database.writing() as connection:
        connection.execute(deliveries.update().values(due_at=0.0))


def message(url: str) -> Delivery:
    return Delivery(1, "msg_1", "0190", "default", url, "{}", None, 1, None)  # type: ignore[arg-type]


def secret() -> list[WebhookSecret]:
    return [WebhookSecret("whsec_c2VjcmV0", None, None)]  # type: ignore[arg-type]


def test_the_end_of_a_job_arrives_signed(bench: Bench, receiver: Receiver) -> None:
    key = bench.store.rotate_webhook_secret("default", HOUR_S)
    job = end_job(bench, receiver.url)
    assert deliver(bench) == 1
    ((headers, body),) = receiver.received
    found = Webhook(key).verify(body, headers)
    JobEnded.model_validate(found)
    assert found.pop("timestamp").endswith("Z")
    data = {"id": job.id, "session_id": job.session_id, "state": "succeeded", "attempt": 1}
    assert found == {"type": "job.succeeded", "data": data}
    assert (headers["content-type"], receiver.paths) == ("application/json", ["/hook?x=1"])
    with pytest.raises(WebhookVerificationError):
        Webhook(key).verify(body + b" ", headers)
    assert deliver(bench) == 0
    assert bench.store.deliveries() == []


def test_nobody_is_told_who_did_not_ask(bench: Bench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    assert bench.store.deliveries() == []


@pytest.mark.parametrize(("end", "state"), [("cancel", "canceled"), ("fail", "failed")])
def test_every_end_is_told(bench: Bench, receiver: Receiver, end: str, state: str) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    spec = JobSpec(callback_url=receiver.url)
    job = bench.store.create_job(bench.session.id, spec, plan(bench.session, spec, 1000), retention_s=-1.0)
    if end == "cancel":
        bench.store.cancel(job.id)
    else:
        bench.stages["detect"] = lambda work: 1 // 0  # type: ignore[assignment, return-value]
        while bench.store.job(job.id).finished_at is None:
            bench.runner().work(60.0)
    bench.store.expire()
    deliver(bench)
    said = [json.loads(body) for _, body in receiver.received]
    assert {one["data"]["state"] for one in said} == {state, "expired"}
    assert {one["type"] for one in said} == {f"job.{state}", "job.expired"}


@pytest.mark.parametrize("status", [301, 302, 307, 400, 404, 429, 500, 503])
def test_what_is_not_taken_comes_again_under_the_same_id(bench: Bench, receiver: Receiver, status: int) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [status]
    deliver(bench)
    (left,) = bench.store.deliveries()
    assert (left.tries, left.problem) == (1, f"It was answered with {status}.")
    assert deliver(bench) == 0  # not yet
    make_due(bench)
    assert deliver(bench) == 1
    assert bench.store.deliveries() == []
    assert len({headers["webhook-id"] for headers, _ in receiver.received}) == 1
    assert receiver.paths == ["/hook?x=1"] * 2  # redirects are not followed


def test_gone_is_gone(bench: Bench, receiver: Receiver) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [410]
    deliver(bench)
    assert bench.store.deliveries() == []


def test_it_is_tried_for_about_a_day_and_then_given_up(bench: Bench, receiver: Receiver) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [500] * 100
    waits_s: list[float] = []
    while bench.store.deliveries():
        assert len(waits_s) < 50
        make_due(bench)
        deliver(bench)
        if left := bench.store.deliveries():
            waits_s.append(left[0].due_at.timestamp() - time.time())
    assert len(receiver.received) == len(waits_s) + 1
    assert all(later > earlier for earlier, later in itertools.pairwise(waits_s))
    assert 20 * HOUR_S < sum(waits_s) < 30 * HOUR_S


def test_who_is_killed_before_it_is_noted_sends_it_again(bench: Bench, receiver: Receiver) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, receiver.url)
    assert len(bench.store.claim_deliveries(10, -1.0)) == 1  # and no word of it
    assert deliver(bench) == 1
    assert len(receiver.received) == 1


def test_two_senders_share_the_work(bench: Bench, receiver: Receiver) -> None:
    end_job(bench, receiver.url)
    assert len(bench.store.claim_deliveries(10, 60.0)) == 1
    assert bench.store.claim_deliveries(10, 60.0) == []


def test_after_a_rotation_both_secrets_sign_for_a_while(bench: Bench, receiver: Receiver) -> None:
    old = bench.store.rotate_webhook_secret("default", HOUR_S)
    other = bench.store.rotate_webhook_secret("other", HOUR_S)
    new = bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, receiver.url)
    deliver(bench)
    ((headers, body),) = receiver.received
    for key in (old, new):
        Webhook(key).verify(body, headers)
    with pytest.raises(WebhookVerificationError):
        Webhook(other).verify(body, headers)
    newest = bench.store.rotate_webhook_secret("default", -1.0)
    assert [one.secret for one in bench.store.webhook_secrets("default")] == [newest, old]
    assert newest not in repr(bench.store.webhook_secrets("default"))


PRIVATE = [
    "127.0.0.1", "127.1.2.3", "10.0.0.1", "172.16.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1", "0.0.0.0",  # noqa: S104
    "255.255.255.255", "224.0.0.1", "240.0.0.1", "::1", "::", "fe80::1", "fc00::1", "ff02::1", "::ffff:127.0.0.1",
    "::ffff:8.8.8.8", "64:ff9b::7f00:1", "2002:7f00:1::", "2002:808:808::",
]  # fmt: skip


def test_which_addresses_are_public() -> None:
    assert not any(map(is_public, PRIVATE))
    assert all(map(is_public, ["8.8.8.8", "1.1.1.1", "2606:4700::1111"]))


class TestNowhereElse:
    """Nothing of ours is reached, whatever a name resolves to and whenever."""

    @pytest.fixture
    def resolved(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
        """What names resolve to, one answer after the other; in the end that all were asked for."""
        answers: list[list[str]] = []

        def look_up(host: str, port: int, *_: object, **__: object) -> list[Any]:
            found = answers.pop(0)
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in found]

        monkeypatch.setattr(socket, "getaddrinfo", look_up)
        yield answers
        assert answers == []

    @pytest.fixture
    def connected(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Where connections were asked for; there is nobody."""
        addresses: list[str] = []

        def connect(address: tuple[str, int], *_: object, **__: object) -> socket.socket:
            addresses.append(address[0])
            raise ConnectionRefusedError

        monkeypatch.setattr(socket, "create_connection", connect)
        return addresses

    @pytest.mark.parametrize("address", PRIVATE)
    def test_private_addresses(self, resolved: list[list[str]], connected: list[str], address: str) -> None:
        resolved.append([address])
        problem = Sender(allow_private=False).send(message("https://hook.example/"), secret())
        assert problem == "The address is not public."
        assert connected == []

    def test_a_name_that_resolves_to_another_address_a_moment_later(
        self, resolved: list[list[str]], connected: list[str]
    ) -> None:
        resolved.append(["93.184.215.14"])  # would it ask again, there would be no answer
        assert Sender(allow_private=False).send(message("https://hook.example/"), secret()) == "The connection failed."
        assert connected == ["93.184.215.14"]

    def test_of_several_addresses_a_public_one_is_taken(self, resolved: list[list[str]], connected: list[str]) -> None:
        resolved.append(["10.0.0.1", "93.184.215.14"])
        Sender(allow_private=False).send(message("https://hook.example/"), secret())
        assert connected == ["93.184.215.14"]

    @pytest.mark.parametrize("host", ["127.0.0.1", "2130706433", "0x7f.1", "localhost", "[::1]"])
    def test_ways_to_write_loopback(self, connected: list[str], host: str) -> None:
        problem = Sender(allow_private=False).send(message(f"http://{host}:9/"), secret())
        assert problem in {"The address is not public.", "The name can't be resolved."}
        assert connected == []

    def test_proxies_of_the_environment_are_not_used(
        self, receiver: Receiver, connected: list[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, receiver.url)
        Sender(allow_private=True).send(message("http://127.0.0.1:9/"), secret())
        assert connected == ["127.0.0.1"]
        assert receiver.received == []


def test_over_tls_the_name_is_verified_not_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    certificate, key = certify(tmp_path, "localhost")
    serving = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    serving.load_cert_chain(certificate, key)
    with receiving(serving) as receiver:
        address = f"https://localhost:{receiver.port}/hook"
        assert Sender(allow_private=True).send(message(address), secret()) == "The connection failed."  # unknown signer
        known = partial(httpcore2.ConnectionPool, ssl_context=ssl.create_default_context(cafile=certificate))
        monkeypatch.setattr(httpcore2, "ConnectionPool", known)
        assert Sender(allow_private=True).send(message(address), secret()) is None
        other = f"https://127.0.0.1:{receiver.port}/hook"
        assert Sender(allow_private=True).send(message(other), secret()) == "The connection failed."
    assert [headers["host"] for headers, _ in receiver.received] == [f"localhost:{receiver.port}"]


@pytest.fixture
def dripping() -> Iterator[Callable[[bytes], str]]:
    """Servers that answer a byte at a time, for ever."""
    servers, over = [], threading.Event()

    def serve(listening: socket.socket, first: bytes) -> None:
        try:
            connection, _ = listening.accept()
            with connection:
                connection.sendall(first)
                while not over.wait(0.02):
                    connection.sendall(b"x")
        except OSError:
            return

    def start(first: bytes) -> str:
        listening = socket.create_server(("127.0.0.1", 0))
        listening.settimeout(20)
        servers.append((listening, threading.Thread(target=serve, args=[listening, first])))
        servers[-1][1].start()
        return f"http://127.0.0.1:{listening.getsockname()[1]}/"

    yield start
    over.set()
    for listening, thread in servers:
        listening.close()
        thread.join()


@pytest.mark.parametrize(
    ("first", "problem"),
    [
        (b"", "The answer took too long."),
        (b"HTTP/1.1 200 OK\r\nX-", "The answer took too long."),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 999999999\r\n\r\n", None),
        (b"SSH-2.0-OpenSSH\r\n\r\n", "The connection failed."),
    ],
)
def test_a_try_has_an_end(dripping: Callable[[bytes], str], first: bytes, problem: str | None) -> None:
    assert Sender(allow_private=True, try_s=0.5).send(message(dripping(first)), secret()) == problem


def test_one_that_hangs_keeps_nobody_waiting(
    bench: Bench, receiver: Receiver, dripping: Callable[[bytes], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.store.rotate_webhook_secret("default", HOUR_S)
    end_job(bench, dripping(b""))
    end_job(bench, receiver.url)
    assert deliver(bench, Sender(allow_private=True, try_s=0.5)) == 2
    assert len(receiver.received) == 1
    assert [one.problem for one in bench.store.deliveries()] == ["The answer took too long."]


def test_a_store_that_fails_ends_nothing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = 0

    def fail(*_: object) -> int:
        nonlocal looks
        looks += 1
        if looks == 3:
            raise KeyboardInterrupt
        raise RuntimeError

    monkeypatch.setattr(webhooks, "deliver_due", fail)
    monkeypatch.setattr(webhooks, "_LOOK_S", 0.0)
    with pytest.raises(KeyboardInterrupt):
        webhooks.deliver_forever(bench.store, Sender(allow_private=False))
