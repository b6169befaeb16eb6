"""Connections to receivers: never into private networks, and the certificate's name is verified."""

import socket
import ssl
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpcore2
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from tests.worker.run.webhooks.conftest import Receiver, message, receiving, secret
from tests.worker.run.webhooks.special_addresses import PRIVATE
from worker.run.webhooks import sender as webhooks
from worker.run.webhooks.sender import Sender


class TestPrivateAddresses:
    """No connection goes to a private address, whatever a name resolves to and when."""

    @pytest.fixture
    def resolved(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
        """Answers of name lookups, in order; the test fails if an answer is left."""
        answers: list[list[str]] = []

        def look_up(host: str, port: int, *_: object, **__: object) -> list[Any]:
            found = answers.pop(0)
            return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, port)) for address in found]

        monkeypatch.setattr(socket, "getaddrinfo", look_up)
        yield answers
        assert answers == []

    @pytest.fixture
    def connected(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Addresses of attempted connections; every attempt is refused."""
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

    def test_name_is_resolved_once(self, resolved: list[list[str]], connected: list[str]) -> None:
        resolved.append(["93.184.215.14"])  # a second lookup would find no answer
        assert Sender(allow_private=False).send(message("https://hook.example/"), secret()) == "The connection failed."
        assert connected == ["93.184.215.14"]

    def test_first_public_address_is_used(self, resolved: list[list[str]], connected: list[str]) -> None:
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
        with pytest.raises(webhooks.RefusedAddressError):
            webhooks.resolve(spelling, 9, allow_private=False)

    def test_name_server_that_does_not_answer(self, monkeypatch: pytest.MonkeyPatch) -> None:
        over = threading.Event()
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: over.wait(20))
        started_s = time.monotonic()
        problem = Sender(allow_private=False, try_s=0.3).send(message("https://hook.example/"), secret())
        over.set()
        assert problem == "The answer took too long."
        assert time.monotonic() - started_s < 5

    def test_proxies_of_environment_are_not_used(
        self, receiver: Receiver, connected: list[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in ("http_proxy", "https_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            monkeypatch.setenv(name, receiver.url)
        Sender(allow_private=True).send(message("http://127.0.0.1:9/"), secret())
        assert connected == ["127.0.0.1"]
        assert receiver.received == []


def certify(folder: Path, name: str) -> tuple[Path, Path]:
    """Write a self-signed certificate of a host and its key."""
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


def test_certificate_must_match_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
