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
from types import SimpleNamespace
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
from worker.jobs.database.connection import now
from worker.jobs.database.tables import deliveries
from worker.jobs.model import Delivery, Job, WebhookSecret
from worker.jobs.repositories.webhooks import MAX_TRIES
from worker.jobs.spec import JobSpec
from worker.planning import plan_job
from worker.webhooks import sender as webhooks
from worker.webhooks.addresses import is_public, url_fault
from worker.webhooks.sender import Courier, Sender

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
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(bench.session, spec, 1000))
    bench.runner().work(60.0)
    return bench.store.jobs.get(job.id)


def deliver(bench: Bench, sender: Sender | None = None) -> int:
    with ThreadPoolExecutor(16) as pool:
        return Courier(bench.store, sender or Sender(allow_private=True), pool).start_due()


def make_due(bench: Bench) -> None:
    with bench.store._database.writing() as connection:
        connection.execute(deliveries.update().values(due_at=0.0))


def message(url: str) -> Delivery:
    return Delivery(1, "msg_1", "0190", "default", url, "{}", None, 1, None)  # type: ignore[arg-type]


def secret() -> list[WebhookSecret]:
    return [WebhookSecret("whsec_c2VjcmV0", None, None)]  # type: ignore[arg-type]


def test_the_end_of_a_job_arrives_signed(bench: Bench, receiver: Receiver) -> None:
    key = bench.store.webhook_secrets.rotate("default", HOUR_S)
    job = end_job(bench, receiver.url)
    assert deliver(bench) == 1
    ((headers, body),) = receiver.received
    found = Webhook(key).verify(body, headers)
    JobEnded.model_validate(found)
    assert found.pop("timestamp").endswith("Z")
    data = {"id": job.id, "session_id": job.session_id, "state": "succeeded", "attempt": 1, "warnings": []}
    assert found == {"type": "job.succeeded", "data": data}
    assert (headers["content-type"], receiver.paths) == ("application/json", ["/hook?x=1"])
    with pytest.raises(WebhookVerificationError):
        Webhook(key).verify(body + b" ", headers)
    assert deliver(bench) == 0
    assert bench.store.webhooks.pending() == []


def test_nobody_is_told_who_did_not_ask(bench: Bench) -> None:
    bench.create_job()
    bench.runner().work(60.0)
    assert bench.store.webhooks.pending() == []


@pytest.mark.parametrize(("end", "state"), [("cancel", "canceled"), ("fail", "failed")])
def test_every_end_is_told(bench: Bench, receiver: Receiver, end: str, state: str) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    spec = JobSpec(callback_url=receiver.url)
    job = bench.store.jobs.add(bench.session.id, spec, plan_job(bench.session, spec, 1000), retention_s=-1.0)
    if end == "cancel":
        bench.store.jobs.cancel(job.id)
    else:
        bench.stages["detect"] = lambda work: 1 // 0  # type: ignore[assignment, return-value]
        while bench.store.jobs.get(job.id).finished_at is None:
            bench.runner().work(60.0)
    bench.store.removals.expire_jobs()
    deliver(bench)
    said = [json.loads(body) for _, body in receiver.received]
    assert {one["data"]["state"] for one in said} == {state, "expired"}
    assert {one["type"] for one in said} == {f"job.{state}", "job.expired"}


@pytest.mark.parametrize("status", [301, 302, 307, 400, 404, 429, 500, 503])
def test_what_is_not_taken_comes_again_under_the_same_id(bench: Bench, receiver: Receiver, status: int) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [status]
    deliver(bench)
    (left,) = bench.store.webhooks.pending()
    assert (left.tries, left.problem) == (1, f"It was answered with {status}.")
    assert deliver(bench) == 0  # not yet
    make_due(bench)
    assert deliver(bench) == 1
    assert bench.store.webhooks.pending() == []
    assert len({headers["webhook-id"] for headers, _ in receiver.received}) == 1
    assert receiver.paths == ["/hook?x=1"] * 2  # redirects are not followed


def test_gone_is_gone(bench: Bench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [410]
    deliver(bench)
    assert bench.store.webhooks.pending() == []


def test_it_is_tried_for_about_a_day_and_then_given_up(bench: Bench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    receiver.statuses = [500] * 100
    waits_s: list[float] = []
    while bench.store.webhooks.pending():
        assert len(waits_s) < 50
        make_due(bench)
        deliver(bench)
        if left := bench.store.webhooks.pending():
            waits_s.append(left[0].due_at.timestamp() - time.time())
    assert len(receiver.received) == len(waits_s) + 1
    assert all(later > earlier for earlier, later in itertools.pairwise(waits_s))
    assert 20 * HOUR_S < sum(waits_s) < 30 * HOUR_S


def test_who_is_killed_before_it_is_noted_sends_it_again(bench: Bench, receiver: Receiver) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    assert len(bench.store.webhooks.claim(10, -1.0)) == 1  # and no word of it
    assert deliver(bench) == 1
    assert len(receiver.received) == 1


def test_two_senders_share_the_work(bench: Bench, receiver: Receiver) -> None:
    end_job(bench, receiver.url)
    assert len(bench.store.webhooks.claim(10, 60.0)) == 1
    assert bench.store.webhooks.claim(10, 60.0) == []


def test_after_a_rotation_both_secrets_sign_for_a_while(bench: Bench, receiver: Receiver) -> None:
    old = bench.store.webhook_secrets.rotate("default", HOUR_S)
    other = bench.store.webhook_secrets.rotate("other", HOUR_S)
    new = bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, receiver.url)
    deliver(bench)
    ((headers, body),) = receiver.received
    for key in (old, new):
        Webhook(key).verify(body, headers)
    with pytest.raises(WebhookVerificationError):
        Webhook(other).verify(body, headers)
    newest = bench.store.webhook_secrets.rotate("default", -1.0)
    assert [one.secret for one in bench.store.webhook_secrets.valid("default")] == [newest, old]
    assert newest not in repr(bench.store.webhook_secrets.valid("default"))


# Of every network of the two IANA registries of special-purpose addresses, and of multicast, some addresses: its first
# and last one, where that is not another network's.
SPECIAL = {
    "this network": ["0.0.0.0", "0.255.255.255"],  # noqa: S104
    "private use": ["10.0.0.1", "10.255.255.255", "172.16.0.1", "172.31.255.255", "192.168.0.0", "192.168.255.255"],
    "shared address space": ["100.64.0.1", "100.127.255.255"],
    "loopback": ["127.0.0.1", "127.1.2.3", "127.255.255.255"],
    "link local": ["169.254.0.0", "169.254.169.254"],
    "IETF protocols": ["192.0.0.0", "192.0.0.8", "192.0.0.9", "192.0.0.10", "192.0.0.170", "192.0.0.255"],
    "documentation": ["192.0.2.1", "198.51.100.255", "203.0.113.7"],
    "AS112": ["192.31.196.1", "192.175.48.6", "2001:4:112::1", "2620:4f:8000::6"],
    "AMT": ["192.52.193.1", "2001:3::1"],
    "6to4 relay": ["192.88.99.0", "192.88.99.2", "192.88.99.255"],
    "benchmarking": ["198.18.0.0", "198.19.255.255", "2001:2::1"],
    "multicast": ["224.0.0.1", "239.255.255.255", "ff00::", "ff02::1", "ff0e::1"],
    "reserved, broadcast": ["240.0.0.0", "255.255.255.255"],
    "unspecified, loopback of IPv6": ["::", "::1"],
    "IPv4-compatible": ["::8.8.8.8", "::127.0.0.1"],
    "IPv4-mapped": ["::ffff:127.0.0.1", "::ffff:8.8.8.8"],
    "translated": ["::ffff:0:8.8.8.8", "64:ff9b::7f00:1", "64:ff9b::808:808", "64:ff9b:1::a00:1", "64:ff9b:1:ffff::1"],
    "discard, dummy": ["100::1", "100:0:0:1::1"],
    "protocols of IPv6": ["2001::", "2001:1ff:ffff::", "2001:1::1", "2001:1::2", "2001:1::3"],
    "Teredo": ["2001:0:4136:e378:8000:63bf:3fff:fdd2"],
    "ORCHID, ORCHIDv2, DETs": ["2001:10::1", "2001:20::1", "2001:2f:ffff::", "2001:30::1"],
    "documentation of IPv6": ["2001:db8::1", "2001:db8:ffff::1", "3fff::", "3fff:fff:ffff::"],
    "6to4": ["2002:7f00:1::", "2002:808:808::", "2002:ffff::1"],
    "SRv6": ["5f00::", "5f00:ffff::1"],
    "unique local": ["fc00::1", "fd00::1", "fdff:ffff::"],
    "link and site local": ["fe80::1", "febf::1", "fec0::1", "feff::1"],
    "with a zone": ["fe80::1%lo", "2606:4700::1111%1"],
}
PRIVATE = [address for addresses in SPECIAL.values() for address in addresses]

PUBLIC = [
    "1.1.1.1", "8.8.8.8", "9.255.255.255", "11.0.0.0", "100.63.255.255", "100.128.0.0", "126.255.255.255", "128.0.0.0",
    "172.15.255.255", "172.32.0.0", "192.0.1.0", "192.0.3.0", "192.88.98.255", "192.88.100.0", "198.17.255.255",
    "198.20.0.0", "223.255.255.255", "2001:200::1", "2001:4860:4860::8888", "2003::1", "2606:4700::1111",
    "2a00:1450:4001::1", "3ffe:ffff::", "3fff:1000::",
]  # fmt: skip


def test_which_addresses_are_public() -> None:
    assert [address for address in PRIVATE if is_public(address)] == []
    assert [address for address in PUBLIC if not is_public(address)] == []


WRONG_URLS = [
    "https://a..b/", "https://.b/", "https://a\uff0eb/", "https://127\u30020\u30020\uff611/", "https://b\u00fccher.example/",
    f"https://{'a' * 64}.example/", f"https://{'a.' * 127}example/", "https://-a.example/", "https://a-.example/",
    "https://xn--\u00e4.example/", "https://xn--999999999.example/", "https://xn--.example/", "https://a.example:0/",
    "https://a.example:65536/", "https://a.example:99999999999999999999/", "https://a.example:+1/", "https://2130706433/",
    "https://0x7f000001/", "https://0x7f.1/", "https://127.1/", "https://0177.0.0.1/", "https://127.0.0.1./",
    "https://017700000001/", "https://1.2.3.256/", "https://1.2.3.4.5/", "https://a.0x/", "https://[::1%25lo]/",
    "https://[fe80::1%25eth0]/", "https://[1.2.3.4]/", "https://[v1.a]/", "https://a%2eb/", "https://a,b/", "https://*/",
    "https://a.example/\u00fc", "https://", "https://[", "https://a.example]/",
    "https://[2606:4700::1111]evil.example/", "https://x[2606:4700::1111]/", "https://[2606:4700::1111][::1]/",
    "https://a.example/\x07", "https://a.example/\t", "https://a.example/?\x7f",
]  # fmt: skip


def test_urls_that_are_wrong_as_they_are_written(bench: Bench) -> None:
    assert [url for url in WRONG_URLS if not url_fault(url)] == []
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    for url in WRONG_URLS:
        queue_for(bench, "default", url)
    while deliver(bench):
        pass
    assert [(one.tries, one.problem) for one in bench.store.webhooks.pending()] == [
        (1, url_fault(url)) for url in WRONG_URLS
    ]


RIGHT_HOSTS = [
    "a",
    "a.example",
    "A.EXAMPLE",
    "a.example.",
    "a_b.example",
    "xn--bcher-kva.example",
    "8.8.8.8",
    "[2606::1]",
]


@pytest.mark.parametrize("host", RIGHT_HOSTS)
def test_urls_that_are_right(host: str) -> None:
    assert url_fault(f"https://{host}/hook?x=%C3%BC") is None
    assert url_fault(f"https://{host}:65535") is None


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

    @pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
    def test_ways_to_write_loopback(self, connected: list[str], host: str) -> None:
        problem = Sender(allow_private=False).send(message(f"http://{host}:9/"), secret())
        assert problem == "The address is not public."
        assert connected == []

    @pytest.mark.parametrize("spelling", ["2130706433", "0x7f.1", "0177.1"])
    def test_numbers_that_only_resolvers_understand(self, connected: list[str], spelling: str) -> None:
        with pytest.raises(webhooks._RefusedError):
            webhooks.resolve(spelling, 9, allow_private=False)

    def test_a_name_server_that_does_not_answer(self, monkeypatch: pytest.MonkeyPatch) -> None:
        over = threading.Event()
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: over.wait(20))
        started_s = time.monotonic()
        problem = Sender(allow_private=False, try_s=0.3).send(message("https://hook.example/"), secret())
        over.set()
        assert problem == "The answer took too long."
        assert time.monotonic() - started_s < 5

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
        unknown = Sender(allow_private=True).send(message(address), secret())
        assert unknown == "The certificate is not valid for this name."
        known = partial(httpcore2.ConnectionPool, ssl_context=ssl.create_default_context(cafile=certificate))
        monkeypatch.setattr(httpcore2, "ConnectionPool", known)
        assert Sender(allow_private=True).send(message(address), secret()) is None
        other = f"https://127.0.0.1:{receiver.port}/hook"
        wrong = Sender(allow_private=True).send(message(other), secret())
        assert wrong == "The certificate is not valid for this name."
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
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, dripping(b""))
    end_job(bench, receiver.url)
    assert deliver(bench, Sender(allow_private=True, try_s=0.5)) == 2
    assert len(receiver.received) == 1
    assert [one.problem for one in bench.store.webhooks.pending()] == ["The answer took too long."]


def test_a_store_that_fails_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing:
        looks = 0

        def claim(self, *_: object) -> list[Delivery]:
            self.looks += 1
            if self.looks == 3:
                raise KeyboardInterrupt
            raise RuntimeError

    monkeypatch.setattr(webhooks, "_LOOK_S", 0.0)
    store = SimpleNamespace(webhooks=Failing())
    with pytest.raises(KeyboardInterrupt):
        webhooks.deliver_forever(store, Sender(allow_private=False))  # type: ignore[arg-type]


class Exploding(Sender):
    """A sender with a fault that nobody has foreseen."""

    def send(self, delivery: Delivery, secrets: object) -> str | None:
        raise LookupError(delivery.url)


def test_an_unforeseen_exception_is_a_try_and_is_given_up_in_the_end(bench: Bench) -> None:
    bench.store.webhook_secrets.rotate("default", HOUR_S)
    end_job(bench, "https://hook.example/")
    assert deliver(bench, Exploding(allow_private=False)) == 1
    (left,) = bench.store.webhooks.pending()
    assert (left.tries, left.problem) == (1, "The try failed; the reaper's log says why.")
    for _ in range(MAX_TRIES - 1):
        make_due(bench)
        assert deliver(bench, Exploding(allow_private=False)) == 1
    assert bench.store.webhooks.pending() == []


def test_tries_that_were_never_recorded_have_an_end_too(bench: Bench, receiver: Receiver) -> None:
    end_job(bench, receiver.url)
    for _ in range(MAX_TRIES):
        assert len(bench.store.webhooks.claim(10, -1.0)) == 1  # and whoever sends is killed
    assert deliver(bench) == 1
    assert bench.store.webhooks.pending() == []
    assert receiver.received == []


class TestBadReceivers:
    """Servers of all kinds on loopback: every try ends in its time and is recorded with its reason."""

    TRY_S = 0.6

    def tried(self, bench: Bench, url: str) -> str | None:
        """Record of a try."""
        bench.store.webhook_secrets.rotate("default", HOUR_S)
        end_job(bench, url)
        started_s = time.monotonic()
        assert deliver(bench, Sender(allow_private=True, try_s=self.TRY_S)) == 1
        assert time.monotonic() - started_s < self.TRY_S + 3
        (left,) = bench.store.webhooks.pending()
        assert left.tries == 1
        assert left.due_at.timestamp() - time.time() > 3  # on the schedule
        return left.problem

    def test_never_answers(self, bench: Bench, silent: str) -> None:
        assert self.tried(bench, silent) == "The answer took too long."

    def test_never_answers_to_tls(self, bench: Bench, silent: str) -> None:
        assert self.tried(bench, silent.replace("http:", "https:")) == "The answer took too long."

    def test_drips_a_handshake(self, bench: Bench, dripping: Callable[[bytes], str]) -> None:
        # The head of a record of TLS, whose 16,384 bytes then come one at a time.
        address = dripping(b"\x16\x03\x03\x40\x00").replace("http:", "https:")
        assert self.tried(bench, address) == "The answer took too long."

    @pytest.mark.parametrize("first", [b"", b"HTTP/1.1 200 OK\r\nX-", b"HTTP/1.1 20"])
    def test_drips_an_answer(self, bench: Bench, dripping: Callable[[bytes], str], first: bytes) -> None:
        assert self.tried(bench, dripping(first)) == "The answer took too long."

    @pytest.mark.parametrize("piece", [b"X-More: " + b"x" * 8000 + b"\r\n", b"HTTP/1.1 100 Continue\r\n\r\n"])
    def test_headers_without_end(self, bench: Bench, flooding: Callable[[bytes], str], piece: bytes) -> None:
        assert self.tried(bench, flooding(piece)) in {"The connection failed.", "The answer took too long."}

    @pytest.mark.parametrize("with_answer", [b"", b"HTTP/1.1 200"])
    def test_closes_at_once(self, bench: Bench, closing: Callable[[bytes], str], with_answer: bytes) -> None:
        assert self.tried(bench, closing(with_answer)) == "The connection failed."

    def test_nobody_listens(self, bench: Bench) -> None:
        assert self.tried(bench, "http://127.0.0.1:1/") == "The connection failed."

    def test_speaks_no_tls(self, bench: Bench, receiver: Receiver) -> None:
        address = receiver.url.replace("http:", "https:")
        assert self.tried(bench, address) == "The TLS handshake failed."

    def test_redirects(self, bench: Bench, receiver: Receiver) -> None:
        receiver.statuses = [302]
        assert self.tried(bench, receiver.url) == "It was answered with 302."
        assert receiver.paths == ["/hook?x=1"]

    def test_is_given_up_after_the_last_try(self, bench: Bench, silent: str) -> None:
        bench.store.webhook_secrets.rotate("default", HOUR_S)
        end_job(bench, silent)
        for _ in range(MAX_TRIES):
            assert len(bench.store.webhooks.pending()) == 1
            make_due(bench)
            assert deliver(bench, Sender(allow_private=True, try_s=0.05)) == 1
        assert bench.store.webhooks.pending() == []


@contextlib.contextmanager
def listening(answer: Callable[[socket.socket, threading.Event], None]) -> Iterator[str]:
    """A server of its own kind for all connections; its address."""
    over, threads = threading.Event(), []

    def serve_one(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            answer(connection, over)

    def serve(server: socket.socket) -> None:
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threads.append(threading.Thread(target=serve_one, args=[connection]))
            threads[-1].start()

    server = socket.create_server(("127.0.0.1", 0))
    threads.append(threading.Thread(target=serve, args=[server]))
    threads[0].start()
    yield f"http://127.0.0.1:{server.getsockname()[1]}/"
    over.set()
    server.shutdown(socket.SHUT_RDWR)
    server.close()
    for thread in threads:
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def silent() -> Iterator[str]:
    """A server that takes everything and never answers."""

    def answer(_: socket.socket, over: threading.Event) -> None:
        over.wait(60)

    with listening(answer) as address:
        yield address


@pytest.fixture
def flooding() -> Iterator[Callable[[bytes], str]]:
    """Servers whose headers have no end."""
    with contextlib.ExitStack() as stack:

        def start(piece: bytes) -> str:
            def answer(connection: socket.socket, over: threading.Event) -> None:
                connection.sendall(b"HTTP/1.1 200 OK\r\n" if piece.startswith(b"X") else b"")
                while not over.is_set():
                    connection.sendall(piece)

            return stack.enter_context(listening(answer))

        yield start


@pytest.fixture
def closing() -> Iterator[Callable[[bytes], str]]:
    """Servers that say something and hang up."""
    with contextlib.ExitStack() as stack:
        yield lambda said: stack.enter_context(listening(lambda connection, _: connection.sendall(said)))


def test_slow_receivers_of_one_tenant_do_not_delay_another_s(
    bench: Bench, receiver: Receiver, silent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forty messages that hang, of one tenant; then one of another tenant, in the service's own loop."""
    for tenant in ("default", "other"):
        bench.store.webhook_secrets.rotate(tenant, HOUR_S)
    for _ in range(40):
        queue_for(bench, "default", silent)
    try_s, ended = 3.0, threading.Event()

    class Ending:
        """Messages of the store, until the test is over."""

        def __getattr__(self, name: str) -> Any:
            if ended.is_set() and name == "claim":
                raise KeyboardInterrupt
            return getattr(bench.store.webhooks, name)

    store = SimpleNamespace(webhooks=Ending(), webhook_secrets=bench.store.webhook_secrets)

    def send() -> None:
        with contextlib.suppress(KeyboardInterrupt):
            webhooks.deliver_forever(store, Sender(allow_private=True, try_s=try_s))  # type: ignore[arg-type]

    monkeypatch.setattr(webhooks, "_LOOK_S", 0.1)
    sending = threading.Thread(target=send)
    sending.start()
    try:
        deadline_s = time.monotonic() + 20
        while sum(one.tries for one in bench.store.webhooks.pending()) < 8:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        started_s = time.monotonic()
        queue_for(bench, "other", receiver.url)
        while not receiver.received:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
        assert time.monotonic() - started_s < try_s
    finally:
        ended.set()
        sending.join(20)
    assert not sending.is_alive()


def queue_for(bench: Bench, tenant: str, url: str) -> None:
    """Have a message of a tenant be due."""
    if not bench.store.webhooks.pending():
        end_job(bench, "https://hook.example/")
        with bench.store._database.writing() as connection:
            connection.execute(deliveries.update().values(tenant=tenant, url=url))
        return
    with bench.store._database.writing() as connection:
        row = connection.execute(deliveries.select().limit(1)).one()._asdict()
        del row["id"]
        new = {"tenant": tenant, "url": url, "tries": 0, "created_at": now(), "due_at": now()}
        connection.execute(deliveries.insert().values(row | new))


def test_tenants_take_turns(bench: Bench) -> None:
    for tenant in ["default"] * 6 + ["second", "third", "second"]:
        queue_for(bench, tenant, "https://hook.example/")

    def claimed(limit: int, busy: dict[str, int]) -> list[str]:
        found = sorted(one.tenant for one in bench.store.webhooks.claim(limit, 60.0, 3, busy))
        make_due(bench)
        return found

    assert claimed(3, {}) == ["default", "second", "third"]
    assert claimed(9, {}) == ["default"] * 3 + ["second"] * 2 + ["third"]
    assert claimed(9, {"default": 3, "second": 2}) == ["second", "third"]
    assert claimed(2, {"second": 1}) == ["default", "third"]
