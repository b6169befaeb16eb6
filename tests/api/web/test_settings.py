"""Settings of the web API: loopback addresses, agreement with the workers', messages for wrong variables."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from api.web.settings import Settings
from tests.cases import slow_but
from worker.run.settings import WorkerSettings, read_settings


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_loopback_is_this_machine(host: str) -> None:
    assert not Settings(host=host).is_exposed


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.org", "localhost.example.org", ""])  # noqa: S104
def test_all_else_is_reached_from_elsewhere(host: str) -> None:
    assert Settings(host=host).is_exposed
    assert not Settings(host=host, trust_network=True).is_exposed


def test_api_and_workers_mean_same_places(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("MULTICAP_DATA_DIR", str(tmp_path))
    api, worker = Settings(), WorkerSettings()
    assert api.resolved_database_url == worker.resolved_database_url
    assert api.artifacts_url == worker.artifacts_url
    assert api.broker_url == worker.broker_url


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("PORT", "abc", "MULTICAP_PORT=abc: must be a whole number from 0 to 65535."),
        ("PORT", "70000", "MULTICAP_PORT=70000: must be a whole number from 0 to 65535."),
        ("TRUST_NETWORK", "perhaps", "MULTICAP_TRUST_NETWORK=perhaps: must be true or false."),
        ("RETENTION_DAYS", "0", "MULTICAP_RETENTION_DAYS=0: must be a number above 0 and of at most 36500."),
        ("ARTIFACTS_URL", "gs://x", "MULTICAP_ARTIFACTS_URL=gs://x: must be a text such as s3://bucket/prefix."),
        ("ALLOWED_HOSTS", "a,b", "MULTICAP_ALLOWED_HOSTS=a,b: must be JSON, a list, each item a text."),
        (
            "TRUSTED_PROXIES",
            '["proxy"]',
            "MULTICAP_TRUSTED_PROXIES: must be JSON, a list, each item an IP address or network.",
        ),
        ("ALLOWED_HOSTS", "[1]", "MULTICAP_ALLOWED_HOSTS: must be JSON, a list, each item a text."),
    ],
)
def test_messages_state_allowed_values_of_variables(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, sentence: str
) -> None:
    monkeypatch.setenv(f"MULTICAP_{name}", value)
    with pytest.raises(SystemExit) as ended:
        read_settings(Settings)
    assert ended.value.code == f"error: {sentence}"


@pytest.mark.slow
def test_command_line_reports_it_too() -> None:
    wrong = os.environ | {"MULTICAP_ALLOWED_HOSTS": "a,b"}
    command = [sys.executable, "-m", "api.cli.main", "keys", "list"]
    done = subprocess.run(command, env=wrong, capture_output=True, text=True, timeout=180, check=False)
    assert (done.returncode, "Traceback" in done.stderr) == (2, False)
    assert "MULTICAP_ALLOWED_HOSTS=a,b: must be JSON" in done.stderr


@pytest.mark.parametrize(
    ("program", "status"),
    slow_but(
        [(["worker"], 1)],
        [(["api.cli.main", "keys", "list"], 2), (["api"], 1), (["worker"], 1), (["worker.run.reaper"], 1)],
    ),
)
def test_wrong_variables_are_named(tmp_path: Path, program: list[str], status: int) -> None:
    wrong = {"MULTICAP_ARTIFACTS_URL": "gs://bucket", "MULTICAP_DATA_DIR": str(tmp_path)}
    command = [sys.executable, "-m", *program]
    done = subprocess.run(command, env=os.environ | wrong, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == status
    assert "MULTICAP_ARTIFACTS_URL" in done.stderr
    assert "Traceback" not in done.stderr
