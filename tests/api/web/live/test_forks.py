"""Server of the processes of live captures: starts with the first one, and again if killed; ends with the service."""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from api.web.live.forks import ForkServer
from api.web.settings import Settings
from pipeline.core.runtime.forks import NUMBER, ForkRequest
from tests.api.conftest import Live, running
from tests.api.web.live.conftest import LiveSocket, opened
from tests.api.web.live.messages import packet

ENVIRONMENT = """
import json, os
from pipeline.core.runtime.forks import serve

def show(arguments):
    print(json.dumps(dict(os.environ)))
    return 0

serve({"show": show})
"""


@pytest.fixture
def own(make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]) -> Iterator[Live]:
    """Running service of a test's own."""
    with running(make_settings(**live_commands)) as live:
        yield live


def begin_and_end(service: Live) -> None:
    """Run a capture of one frame."""
    with opened(service) as connection:
        client = LiveSocket(connection)
        client.start()
        client.send(packet())
        assert len(client.ended()[0]) == 1


def test_server_starts_with_first_capture_and_ends_with_service(
    make_settings: Callable[..., Settings], live_commands: dict[str, tuple[str, ...]]
) -> None:
    with running(make_settings(**live_commands)) as service:
        forks = service.services.live_forks
        assert forks.pid is None
        begin_and_end(service)
        server = psutil.Process(forks.pid)
        begin_and_end(service)
        assert forks.pid == server.pid
    assert not server.is_running()


def test_killed_server_is_started_again(own: Live) -> None:
    forks = own.services.live_forks
    with opened(own) as connection:
        client = LiveSocket(connection)
        client.start()
        first = forks.pid
        assert first is not None
        os.kill(first, signal.SIGKILL)
        # Its captures end with it, as those of a failed process.
        assert client.problem()["code"] == "live_failed"
    begin_and_end(own)
    assert forks.pid != first


def test_forks_have_no_secrets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("MULTICAP_DATABASE_URL", "AWS_SECRET_ACCESS_KEY", "SOMETHING_ELSE"):
        monkeypatch.setenv(name, "postgresql://user:password@host")
    monkeypatch.setenv("MULTICAP_HOME", "/somewhere")
    path = tmp_path / "server.py"
    path.write_text(ENVIRONMENT, encoding="utf-8")
    server = ForkServer((sys.executable, "-P", str(path)))
    output = tmp_path / "output"
    with output.open("wb") as file, Path(os.devnull).open("rb") as nothing:
        request = ForkRequest("show", (), str(tmp_path), 2**29, 2**20, None, 5)
        owner = server.fork(request, (nothing.fileno(), file.fileno(), file.fileno()))
    with owner:
        owner.settimeout(60)
        assert [owner.recv(NUMBER.size) for _ in range(2)][1] == NUMBER.pack(0)
    environment = json.loads(output.read_text())
    assert environment["MULTICAP_HOME"] == "/somewhere"
    assert environment["TMPDIR"] == str(tmp_path)
    assert "password" not in json.dumps(environment)
    server.close()
    assert server.pid is None
