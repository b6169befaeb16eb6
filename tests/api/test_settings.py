from pathlib import Path

import pytest
from pydantic import ValidationError

from api.settings import Settings
from worker.settings import WorkerSettings


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_listens_on_loopback(host: str) -> None:
    assert Settings(host=host).host == host


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org", "localhost.example.org", ""])  # noqa: S104
def test_refuses_to_listen_beyond_loopback(host: str) -> None:
    with pytest.raises(ValidationError, match="loopback"):
        Settings(host=host)


def test_listens_beyond_loopback_where_told_to() -> None:
    assert Settings(host="0.0.0.0", trust_network=True).trust_network  # noqa: S104


def test_api_and_workers_mean_the_same_places(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MULTICAP_DATA_DIR", str(tmp_path))
    api, worker = Settings(), WorkerSettings()
    assert api.resolved_database_url == worker.resolved_database_url
    assert api.artifacts_dir == worker.artifacts_dir
    assert api.broker_url == worker.broker_url
