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
from pathlib import Path

import httpx2
import pytest
import trustme
import uvicorn
import websockets.sync.client
from cryptography import x509
from typer.testing import CliRunner

from api.app import create_app
from api.cli.certificates import CertificateError, Encryption, given_encryption, machine_names, own_encryption
from api.cli.main import app
from api.http.server import server_config
from api.settings import Settings
from tests.api.conftest import Live, problem_of
from worker.jobs.model.rights import Scope
from worker.jobs.store import JobStore

runner = CliRunner()


def certificate_of(encryption: Encryption) -> x509.Certificate:
    return x509.load_pem_x509_certificate(encryption.certificate.read_bytes())


def test_the_authority_stays_and_certificates_are_new(tmp_path: Path) -> None:
    first = own_encryption(tmp_path)
    before = first.certificate.read_bytes()
    assert first.authority is not None
    authority = first.authority.read_bytes()
    second = own_encryption(tmp_path)
    assert second.authority is not None
    assert second.authority.read_bytes() == authority
    assert second.certificate.read_bytes() != before
    found = certificate_of(second)
    found.verify_directly_issued_by(x509.load_pem_x509_certificate(authority))
    valid = found.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    assert valid < datetime.timedelta(days=398)  # phones accept no longer ones
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert "localhost" in names.get_values_for_type(x509.DNSName)
    assert {"127.0.0.1", "::1"} <= {str(address) for address in names.get_values_for_type(x509.IPAddress)}
    assert set(second.names) == set(machine_names())
    for name in ("authority-key.pem", "certificate-key.pem"):
        assert "PRIVATE KEY" in (tmp_path / "certificates" / name).read_text()
    assert stat.S_IMODE((tmp_path / "certificates").stat().st_mode) == 0o700


def test_a_damaged_authority_is_a_sentence(tmp_path: Path) -> None:
    own_encryption(tmp_path)
    (tmp_path / "certificates" / "authority-key.pem").write_text("damaged")
    with pytest.raises(CertificateError, match="Remove the folder"):
        own_encryption(tmp_path)


@pytest.fixture
def given(tmp_path: Path) -> tuple[Path, Path]:
    """Certificate of somebody's own, and its key."""
    issued = trustme.CA().issue_cert("studio.example", "*.studio.example", "192.0.2.7")
    certificate, key = tmp_path / "studio.pem", tmp_path / "studio-key.pem"
    certificate.write_bytes(b"".join(pem.bytes() for pem in issued.cert_chain_pems))
    issued.private_key_pem.write_to_path(str(key))
    return certificate, key


def test_a_given_certificate_says_by_which_names_the_service_is_called(given: tuple[Path, Path]) -> None:
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


def test_without_an_authority_there_is_no_certificate_to_get(service: Live) -> None:
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
