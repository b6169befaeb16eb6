"""Encryption by the service itself: certificates that are made and given, and phones over it."""

import base64
import contextlib
import datetime
import json
import ssl
import stat
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import httpx2
import pytest
import uvicorn
import websockets.sync.client
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from typer.testing import CliRunner

from api.cli import certificates as module
from api.cli.certificates import (
    VALID_DAYS,
    CertificateError,
    Encryption,
    given_encryption,
    is_trusted,
    machine_names,
    new_authority,
    own_encryption,
    pem_of_certificate,
    pem_of_key,
)
from api.cli.main import app
from api.web.app import create_app
from api.web.http.server import server_config
from api.web.settings import Settings
from tests.api.conftest import Live, problem_of
from tests.waiting import wait_for
from worker.store.model.rights import Scope
from worker.store.store import JobStore

runner = CliRunner()


NAMES = ("192.168.1.20", "studio.local", "localhost", "127.0.0.1", "::1")
FOREIGN = ("bank.example", "192.168.1.21", "fd00::1", "studio", "other.local", "local", "example.localdomain")


def certificate_of(encryption: Encryption) -> x509.Certificate:
    return x509.load_pem_x509_certificate(encryption.certificate.read_bytes())


def authority_of(encryption: Encryption) -> x509.Certificate:
    assert encryption.authority is not None
    return x509.load_pem_x509_certificate(encryption.authority.read_bytes())


def shake_hands(client: ssl.SSLContext, certificate: Path, key: Path, name: str) -> None:
    """Greet a server by TLS that has a certificate, without a network; raises what the client refuses."""
    server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server.load_cert_chain(certificate, key)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        client.wrap_bio(to_client, to_server, server_hostname=name),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    while ends:
        for end in list(ends):
            with contextlib.suppress(ssl.SSLWantReadError):
                end.do_handshake()
                ends.remove(end)


def test_authority_signs_only_names_of_its_machine(tmp_path: Path) -> None:
    now = datetime.datetime.now(datetime.UTC)
    authority = new_authority("studio", [*NAMES, "dev"], now)
    root = tmp_path / "authority.pem"
    root.write_bytes(pem_of_certificate(authority.certificate))
    client = ssl.create_default_context(cafile=str(root))
    for name in (*NAMES, *FOREIGN, "dev", "a.dev"):
        signed, key = authority.sign([name])
        (tmp_path / "certificate.pem").write_bytes(pem_of_certificate(signed))
        (tmp_path / "key.pem").write_bytes(pem_of_key(key))
        assert is_trusted(signed, authority.certificate, name, now) == (name in NAMES), name
        refused = contextlib.nullcontext() if name in NAMES else pytest.raises(ssl.SSLCertVerificationError)
        with refused:
            shake_hands(client, tmp_path / "certificate.pem", tmp_path / "key.pem", name)
    # A foreign name beside an own one makes the whole certificate worthless.
    signed, _ = authority.sign(["localhost", "bank.example"])
    assert not is_trusted(signed, authority.certificate, "localhost", now)


def test_authority_signs_only_servers_and_no_authority() -> None:
    found = new_authority("studio", NAMES, datetime.datetime.now(datetime.UTC)).certificate.extensions
    constraints = found.get_extension_for_class(x509.NameConstraints)
    assert constraints.critical
    assert constraints.value.permitted_subtrees is not None
    assert {str(name.value).partition("/")[0] for name in constraints.value.permitted_subtrees} == set(NAMES)
    basic = found.get_extension_for_class(x509.BasicConstraints)
    assert (basic.critical, basic.value.ca, basic.value.path_length) == (True, True, 0)
    usages = found.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert list(usages) == [x509.oid.ExtendedKeyUsageOID.SERVER_AUTH]


def test_authority_certificate_is_kept_and_its_key_is_not(tmp_path: Path) -> None:
    first = own_encryption(tmp_path)
    contents = {path.name: path.read_bytes() for path in (tmp_path / "certificates").iterdir()}
    assert sorted(contents) == ["authority.pem", "certificate-key.pem", "certificate.pem"]
    second = own_encryption(tmp_path)
    assert (second.names, second.has_replaced) == (first.names, False)
    assert {path.name: path.read_bytes() for path in (tmp_path / "certificates").iterdir()} == contents
    found = certificate_of(second)
    found.verify_directly_issued_by(authority_of(second))
    key = load_pem_private_key(contents["certificate-key.pem"], None)
    spki = (serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)
    assert key.public_key().public_bytes(*spki) == found.public_key().public_bytes(*spki)
    assert key.public_key().public_bytes(*spki) != authority_of(second).public_key().public_bytes(*spki)
    for certificate in (found, authority_of(second)):
        valid = certificate.not_valid_after_utc - certificate.not_valid_before_utc
        assert valid == datetime.timedelta(days=VALID_DAYS)
    assert VALID_DAYS <= 825  # phones accept no longer ones
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "localhost" in names.get_values_for_type(x509.DNSName)
    assert {"127.0.0.1", "::1"} <= {str(address) for address in names.get_values_for_type(x509.IPAddress)}
    assert set(second.names) == set(machine_names())
    assert stat.S_IMODE((tmp_path / "certificates" / "certificate-key.pem").stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / "certificates").stat().st_mode) == 0o700


def test_authority_is_remade_for_new_names_or_after_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "machine_names", partial(iter, NAMES))
    first = authority_of(own_encryption(tmp_path))
    # An address beside the one of phones changes nothing.
    more = (*NAMES[:1], "172.17.0.1", *NAMES[1:])
    monkeypatch.setattr(module, "machine_names", partial(iter, more))
    kept = own_encryption(tmp_path)
    assert (authority_of(kept), kept.names, kept.has_replaced) == (first, NAMES, False)
    before = first
    for names in (("192.168.1.21", *NAMES[1:]), ("192.168.1.21", "other.local", *NAMES[2:])):
        monkeypatch.setattr(module, "machine_names", partial(iter, names))
        renewed = own_encryption(tmp_path)
        assert authority_of(renewed) != before
        assert (renewed.names, renewed.has_replaced) == (names, True)
        before = authority_of(renewed)
    monkeypatch.setattr(module, "_RENEWED_BEFORE", datetime.timedelta(days=VALID_DAYS))
    assert own_encryption(tmp_path).has_replaced


@pytest.mark.parametrize("name", ["authority.pem", "certificate.pem", "certificate-key.pem"])
def test_damaged_and_missing_certificates_are_made_anew(tmp_path: Path, name: str) -> None:
    file = tmp_path / "certificates" / name
    for is_there in (True, False):
        before = authority_of(own_encryption(tmp_path))
        if is_there:
            file.write_text("damaged")
        else:
            file.unlink()
        renewed = own_encryption(tmp_path)
        assert renewed.has_replaced
        assert authority_of(renewed) != before


def test_unusable_folder_is_sentence(tmp_path: Path) -> None:
    (tmp_path / "certificates").write_text("a file")
    with pytest.raises(CertificateError, match="Check its owner and mode"):
        own_encryption(tmp_path)


@pytest.fixture
def given(tmp_path: Path) -> tuple[Path, Path]:
    """Certificate of somebody's own, and its key."""
    names = ["studio.example", "192.0.2.7"]
    signed, signing = new_authority("studio", names, datetime.datetime.now(datetime.UTC)).sign(
        ["studio.example", "*.studio.example", "192.0.2.7"]
    )
    certificate, key = tmp_path / "studio.pem", tmp_path / "studio-key.pem"
    certificate.write_bytes(pem_of_certificate(signed))
    key.write_bytes(pem_of_key(signing))
    return certificate, key


def test_certificate_given_states_names_of_service(given: tuple[Path, Path]) -> None:
    encryption = given_encryption(*given)
    assert encryption.names == ("studio.example", "192.0.2.7")
    variables = encryption.environment(8443, ["other.example"], None)
    assert variables["MULTICAP_PUBLIC_URL"] == "https://studio.example:8443"
    assert json.loads(variables["MULTICAP_ALLOWED_HOSTS"]) == ["192.0.2.7", "other.example", "studio.example"]
    assert "MULTICAP_CERTIFICATE_AUTHORITY" not in variables
    assert encryption.environment(1, [], "https://a.example")["MULTICAP_PUBLIC_URL"] == "https://a.example"


def test_files_that_do_not_belong_together_are_refused(given: tuple[Path, Path], tmp_path: Path) -> None:
    other = own_encryption(tmp_path / "data")
    for certificate, key in ((given[0], other.key), (tmp_path / "missing", given[1]), (given[1], given[1])):
        with pytest.raises(CertificateError, match="belong together"):
            given_encryption(certificate, key)
    result = runner.invoke(app, ["serve", "--certificate", str(given[0]), "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert "--certificate-key" in result.stderr
    with pytest.raises(ValueError, match="belong together"):
        Settings(certificate=given[0])
    with pytest.raises(ValueError, match="belong together"):
        Settings(certificate_key=given[1])


@contextlib.contextmanager
def encrypted(settings: Settings) -> Iterator[int]:
    """Port of a running service that encrypts by itself."""
    server = uvicorn.Server(server_config(create_app(settings), settings.model_copy(update={"port": 0})))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    deadline_s = time.monotonic() + 120
    while not server.started:
        assert thread.is_alive()
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    try:
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        # uvicorn fails if a WebSocket is being closed when it stops.
        wait_for(lambda: not server.server_state.connections, timeout_s=30.0)
        server.should_exit = True
        thread.join(120)


def test_phones_join_and_upload_over_it(make_settings: Callable[..., Settings], tmp_path: Path) -> None:
    encryption = own_encryption(tmp_path)
    assert encryption.authority is not None
    settings = make_settings(
        certificate=encryption.certificate,
        certificate_key=encryption.key,
        certificate_authority=encryption.authority,
        public_url="https://192.168.1.20:8443",
    )
    trusting = ssl.create_default_context(cafile=str(encryption.authority))
    with encrypted(settings) as port, httpx2.Client(base_url=f"https://localhost:{port}", verify=trusting) as client:
        authority = client.get("/certificate")
        assert authority.content == encryption.authority.read_bytes()
        assert authority.headers["content-type"] == "application/x-x509-ca-cert"
        opened = client.post("/v1/recordings", json={}).json()
        assert opened["join"]["url"].startswith(f"https://192.168.1.20:8443/record#join={opened['id']}.mcl_")
        secret = opened["join"]["secret"]
        address = f"wss://localhost:{port}/v1/recordings/{opened['id']}/connect"
        with websockets.sync.client.connect(address, ssl=trusting, subprotocols=[f"mc.link.{secret}"]) as phone:  # type: ignore[list-item]
            phone.send(json.dumps({"type": "hello", "phone_id": "a-phone-over-an-encrypted-line"}))
            assert json.loads(phone.recv(30.0))["type"] == "welcome"
            headers = {
                "Authorization": f"Bearer {secret}",
                "Multicap-Phone": "a-phone-over-an-encrypted-line",
                "Tus-Resumable": "1.0.0",
                "Upload-Length": "90000",
                "Upload-Metadata": f"filename {base64.b64encode(b'a.webm').decode()}",
                "Content-Type": "application/offset+octet-stream",
            }
            sent = client.post("/v1/uploads", headers=headers, content=bytes(90_000))
            assert (sent.status_code, sent.headers["upload-offset"]) == (201, "90000")
        with pytest.raises(httpx2.TransportError):
            httpx2.get(f"http://localhost:{port}/healthz")


def test_without_authority_there_is_no_certificate_to_get(service: Live) -> None:
    problem_of(service.client.get("/certificate"), 404, "not_found")


def test_browsers_get_secure_cookies(make_settings: Callable[..., Settings], tmp_path: Path) -> None:
    encryption = own_encryption(tmp_path)
    settings = make_settings(certificate=encryption.certificate, certificate_key=encryption.key)
    trusting = encryption.client_context()
    with encrypted(settings) as port, httpx2.Client(base_url=f"https://localhost:{port}", verify=trusting) as client:
        store = JobStore(settings.resolved_database_url)
        _, secret = store.keys.add("mine", "host", frozenset(Scope))
        store.close()
        answer = client.post("/v1/browser-session", json={"key": secret})
        cookie = answer.headers["set-cookie"]
        assert cookie.startswith("__Host-")
        assert "Secure" in cookie
        # The page's own WebSockets bring the cookie, and no key.
        opened = client.post("/v1/recordings", json={}, headers={"Origin": f"https://localhost:{port}"}).json()
        address = f"wss://localhost:{port}/v1/recordings/{opened['id']}/connect"
        page = {"Cookie": cookie.partition(";")[0], "Origin": f"https://localhost:{port}"}
        with websockets.sync.client.connect(address, ssl=trusting, additional_headers=page, open_timeout=60) as host:
            assert json.loads(host.recv(30.0))["type"] == "state"
