"""Event streams, downloads and uploads end with their key, even if another process revokes it."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest

from api.web.settings import MIB, Settings
from tests.api.conftest import Live, running
from tests.api.web.uploads.test_files import PIECE
from tests.s3 import running_s3
from worker.store.model.rights import Key, Scope

# More than all network buffers hold.
CONTENT = os.urandom(48 * MIB)
PATIENCE_S = 30.0
USUAL = frozenset({Scope.READ, Scope.WRITE})
DOWNLOADS = ("results/person-1.bvh", "results.zip")


@pytest.fixture(scope="module", params=["folder", "s3"])
def live(request: pytest.FixtureRequest, make_settings: Callable[..., Settings]) -> Iterator[Live]:
    with contextlib.ExitStack() as stack:
        changes = {}
        if request.param == "s3":
            s3 = stack.enter_context(running_s3())
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            for name, value in s3.environment.items():
                patch.setenv(name, value)
            changes = {"artifacts_url": s3.new_url()}
        live = stack.enter_context(running(make_settings(**changes)))
        # From here on the service has keys; the client that prepares records uses another key.
        _, secret = live.services.store.keys.add("studio", "first", USUAL)
        live.client.headers["Authorization"] = f"Bearer {secret}"
        yield live


@pytest.fixture(autouse=True)
def no_work(request: pytest.FixtureRequest) -> Iterator[None]:
    """Cancel the jobs of a test, so that the next test starts without work."""
    yield
    if "live" in request.fixturenames:
        client = request.getfixturevalue("live").client
        for job in client.get("/v1/jobs", params={"state": "queued"}).json()["jobs"]:
            client.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()


@pytest.fixture
def key(live: Live) -> tuple[Key, str]:
    return live.services.store.keys.add("studio", "portal", USUAL)


@contextlib.contextmanager
def asking(live: Live, path: str, secret: str | None, method: str = "GET", **headers: str) -> Iterator[socket.socket]:
    """Send a request, and return the connection before any byte of the response is read."""
    named = {"Host": "localhost", **headers} | ({"Authorization": f"Bearer {secret}"} if secret else {})
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in named.items()), "", ""]
    with socket.create_connection(live.address[:2], timeout=PATIENCE_S) as connection:
        connection.sendall("\r\n".join(lines).encode())
        yield connection


def read_to_end(connection: socket.socket) -> int:
    """Number of bytes until the service closes the connection."""
    num_bytes = 0
    with contextlib.suppress(ConnectionResetError):
        while block := connection.recv(2**20):
            num_bytes += len(block)
    return num_bytes


def revoke(live: Live, key: Key) -> None:
    """Revoke a key in another process, as an operator does."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "api.cli.main",
        "keys",
        "revoke",
        key.id,
        "--data",
        str(live.settings.data_dir),
    ]
    subprocess.run(command, check=True, timeout=PATIENCE_S, capture_output=True)


def test_event_streams_end_when_key_is_revoked(live: Live, key: tuple[Key, str]) -> None:
    path = f"/v1/jobs/{live.job_id()}/events"
    with asking(live, path, key[1]) as stream, asking(live, path, key[1]) as second:
        assert stream.recv(65536).startswith(b"HTTP/1.1 200 ")
        revoke(live, key[0])
        revoked_s = time.monotonic()
        read_to_end(stream)
        read_to_end(second)
        assert time.monotonic() - revoked_s < 10.0
    assert live.client.get("/v1/jobs").status_code == 200


@pytest.mark.parametrize("download", DOWNLOADS)
def test_downloads_end_when_key_is_revoked(live: Live, key: tuple[Key, str], download: str) -> None:
    job_id = live.job_id()
    live.finish(job_id, CONTENT)
    with asking(live, f"/v1/jobs/{job_id}/{download}", key[1]) as sent:
        assert sent.recv(1000).startswith(b"HTTP/1.1 200 ")
        revoke(live, key[0])
        time.sleep(3.0)  # takes a second on a slow machine; the body is sent while it is read
        assert read_to_end(sent) < len(CONTENT) / 2


def test_uploads_end_when_key_is_revoked(live: Live, key: tuple[Key, str]) -> None:
    uploads = {"Upload-Length": "90000", "Upload-Metadata": "filename Y2FtXzAubXA0", "Tus-Resumable": "1.0.0"}
    address = live.client.post("/v1/uploads", headers=uploads).headers["location"]
    piece = PIECE | {"Upload-Offset": "0", "Content-Length": "90000"}
    with asking(live, address, key[1], "PATCH", **piece) as connection:
        connection.sendall(b"x" * 1000)
        revoke(live, key[0])
        connection.settimeout(0.2)
        deadline_s, answer = time.monotonic() + PATIENCE_S, b""
        while not answer:
            assert time.monotonic() < deadline_s
            connection.sendall(b"x")
            with contextlib.suppress(TimeoutError):
                answer = connection.recv(65536)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert int(live.client.head(address, headers={"Tus-Resumable": "1.0.0"}).headers["upload-offset"]) < 90000


def test_event_streams_end_when_key_expires(live: Live) -> None:
    path = f"/v1/jobs/{live.job_id()}/events"
    _, secret = live.services.store.keys.add("studio", "guest", USUAL, lifetime_s=2.0)
    with asking(live, path, secret) as stream:
        assert stream.recv(65536).startswith(b"HTTP/1.1 200 ")
        read_to_end(stream)


def test_event_streams_of_browsers_end_with_their_key(live: Live, key: tuple[Key, str]) -> None:
    path = f"/v1/jobs/{live.job_id()}/events"
    cookie = live.services.store.browser_sessions.open(key[0], 3600.0)
    with asking(live, path, None, Cookie=f"multicap_session={cookie}") as stream:
        assert stream.recv(65536).startswith(b"HTTP/1.1 200 ")
        revoke(live, key[0])
        read_to_end(stream)


def test_event_streams_without_key_end_when_there_are_keys(make_settings: Callable[..., Settings]) -> None:
    with running(make_settings()) as live, asking(live, f"/v1/jobs/{live.job_id()}/events", None) as stream:
        assert stream.recv(65536).startswith(b"HTTP/1.1 200 ")
        live.services.store.keys.add("studio", "first", USUAL)
        read_to_end(stream)
        assert live.client.get("/v1/jobs").status_code == 401


def test_streams_of_other_keys_continue(live: Live, key: tuple[Key, str]) -> None:
    _, other = live.services.store.keys.add("studio", "other", USUAL)
    path = f"/v1/jobs/{live.job_id()}/events"
    with asking(live, path, key[1]) as ending, asking(live, path, other) as going_on:
        assert going_on.recv(65536).startswith(b"HTTP/1.1 200 ")
        revoke(live, key[0])
        read_to_end(ending)
        live.client.post(path.replace("events", "cancel")).raise_for_status()
        while b"canceled" not in (block := going_on.recv(65536)):
            assert block
