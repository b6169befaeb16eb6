"""Settings out of files that variables name: values, all problems at once, no secret in a message."""

from pathlib import Path

import pytest

from api.web.settings import Settings
from tests.s3 import S3
from worker.run.embedded import lock
from worker.run.settings import WorkerSettings, read_settings
from worker.store.files.s3 import FileCache, S3Artifacts

URL = "postgresql://multicap:geheim@db.example/multicap"


def write(monkeypatch: pytest.MonkeyPatch, path: Path, variable: str, content: str | bytes) -> None:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    monkeypatch.setenv(f"{variable}_FILE", str(path))


def refusals() -> list[str]:
    with pytest.raises(SystemExit) as ended:
        read_settings(Settings)
    return str(ended.value.code).splitlines()


@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_values_come_from_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, end: str) -> None:
    write(monkeypatch, tmp_path / "url", "MULTICAP_DATABASE_URL", URL + end)
    write(monkeypatch, tmp_path / "hosts", "MULTICAP_ALLOWED_HOSTS", f'["capture.example"]{end}')
    write(monkeypatch, tmp_path / "port", "MULTICAP_PORT", f"9000{end}")
    settings = read_settings(Settings)
    assert settings.resolved_database_url == URL
    assert settings.allowed_hosts == {"capture.example"}
    assert settings.port == 9000
    assert read_settings(WorkerSettings).database_url == URL


def test_all_problems_are_named_at_once_without_secrets(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(monkeypatch, tmp_path / "both", "MULTICAP_DATABASE_URL", URL)
    monkeypatch.setenv("MULTICAP_DATABASE_URL", URL)
    monkeypatch.setenv("MULTICAP_BROKER_URL_FILE", str(tmp_path / "missing"))
    write(monkeypatch, tmp_path / "empty", "MULTICAP_ARTIFACTS_URL", "\n")
    write(monkeypatch, tmp_path / "hosts", "MULTICAP_ALLOWED_HOSTS", "geheim")
    write(monkeypatch, tmp_path / "bytes", "AWS_ACCESS_KEY_ID", b"\xff\xfe")
    write(monkeypatch, tmp_path / "large", "AWS_SECRET_ACCESS_KEY", "geheim" * 20_000)
    lines = refusals()
    assert lines == [
        "error: MULTICAP_DATABASE_URL and MULTICAP_DATABASE_URL_FILE are both set: set one of them.",
        f"error: MULTICAP_ARTIFACTS_URL_FILE={tmp_path / 'empty'}: the file is empty.",
        f"error: MULTICAP_BROKER_URL_FILE={tmp_path / 'missing'}: the file can't be read (No such file or directory).",
        f"error: MULTICAP_ALLOWED_HOSTS_FILE={tmp_path / 'hosts'}: the file must hold JSON.",
        f"error: AWS_ACCESS_KEY_ID_FILE={tmp_path / 'bytes'}: the file must hold text in UTF-8.",
        f"error: AWS_SECRET_ACCESS_KEY_FILE={tmp_path / 'large'}: the file is larger than 64 KiB.",
    ]


def test_refused_value_of_file_is_not_shown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(monkeypatch, tmp_path / "url", "MULTICAP_ARTIFACTS_URL", "geheim://bucket")
    assert refusals() == [
        f"error: MULTICAP_ARTIFACTS_URL_FILE={tmp_path / 'url'}: the file must hold a text such as s3://bucket/prefix."
    ]


def test_serve_replaces_files_of_its_own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write(monkeypatch, tmp_path / "broker", "MULTICAP_BROKER_URL", "redis://other.example/0")
    with lock(tmp_path / "data") as directory:
        environment = directory.environment()
    assert environment["MULTICAP_BROKER_URL"].startswith("redis+socket://")
    assert "MULTICAP_BROKER_URL_FILE" not in environment


def test_keys_of_bucket_come_from_files(s3: S3, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in s3.environment.items():
        if name in {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"}:
            monkeypatch.delenv(name, raising=False)
            write(monkeypatch, tmp_path / name, name, f"{name.lower()}\n")
        else:
            monkeypatch.setenv(name, value)
    store = S3Artifacts(s3.new_url(), FileCache(tmp_path / "cache", 1000, 60.0))
    store.put_bytes("a", b"content")
    address = store.signed_url("a", 60.0)
    with store.open("a") as file:
        assert file.read() == b"content"
    assert address is not None
    assert "Credential=aws_access_key_id%2F" in address
