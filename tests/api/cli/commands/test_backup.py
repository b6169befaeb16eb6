"""`multicap backup`: sentences for an operator, and JSON and exit codes for scripts."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from tests.worker.store.backups import opened_data
from worker.store.database.connection import Database

runner = CliRunner()

BUCKET = "s3://videos/multicap"


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DATABASE_URL", "ARTIFACTS_URL", "DATA_DIR"):
        monkeypatch.delenv(f"MULTICAP_{name}", raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with opened_data(tmp_path / "data") as data:
        session_id = data.add_session()
        data.add_job(session_id)
        data.run_all()
    return tmp_path / "data"


def test_create_verify_and_restore_print_summaries(folder: Path, tmp_path: Path) -> None:
    archive, there = tmp_path / "b.tar", tmp_path / "there"
    for arguments in (
        ["create", f"{archive}", f"--data={folder}"],
        ["verify", f"{archive}"],
        ["restore", f"{archive}", f"--data={there}"],
    ):
        result = runner.invoke(app, ["backup", *arguments])
        assert result.exit_code == 0, result.stderr
        assert result.stdout == ""
        assert "1 sessions, 1 jobs (1 succeeded), 0 uploads, 7 files" in result.stderr
    with opened_data(there) as data:
        assert len(data.store.jobs.page()) == 1


def test_scripts_get_object_and_exit_codes(folder: Path, tmp_path: Path) -> None:
    archive = tmp_path / "b.tar"
    (video,) = folder.glob("artifacts/sessions/*/inputs/0-*")
    video.unlink()
    result = runner.invoke(app, ["backup", "create", f"{archive}", f"--data={folder}", "--json"])
    created = json.loads(result.stdout)
    path = str(video.relative_to(folder))
    assert result.exit_code == 1
    assert created["file_problems"] == [{"path": path, "problem": "missing", "needed": True}]
    assert (created["files"], created["rows"]["jobs"], created["faults"]) == (6, {"succeeded": 1}, [])
    assert created["archive_bytes"] == archive.stat().st_size
    # Problems that were known when the backup was created are not faults of the archive.
    result = runner.invoke(app, ["backup", "verify", f"{archive}"])
    assert (result.exit_code, "is whole" in result.stderr, path in result.stderr) == (1, True, True)
    content = bytearray(archive.read_bytes())
    content[len(content) // 2] ^= 1
    archive.write_bytes(content)
    result = runner.invoke(app, ["backup", "verify", f"{archive}", "--json"])
    assert result.exit_code == 1
    assert any("damaged" in fault for fault in json.loads(result.stdout)["faults"])
    result = runner.invoke(app, ["backup", "restore", f"{archive}", f"--data={tmp_path / 'there'}", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.stdout)["problems"][0]["code"] == "backup_failed"
    assert not (tmp_path / "there").exists()
    result = runner.invoke(app, ["backup", "create", f"{archive}", f"--data={folder}"])
    assert (result.exit_code, "is there already" in result.stderr) == (2, True)


@pytest.mark.parametrize(
    ("url", "sentence"),
    [("nonsense", "database failed"), ("mysql://x/y", "no driver"), ("sqlite:////none/x.db", "There is no database")],
)
def test_wrong_databases_are_refused_in_sentence(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, sentence: str
) -> None:
    monkeypatch.setenv("MULTICAP_DATABASE_URL", url)
    result = runner.invoke(app, ["backup", "create", f"{tmp_path / 'b.tar'}", f"--data={folder}"])
    assert result.exit_code in {1, 2}
    assert sentence in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_artifacts_in_bucket_stay_there_and_that_is_said(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = tmp_path / "b.tar"
    monkeypatch.setenv("MULTICAP_ARTIFACTS_URL", BUCKET)
    for arguments in (["create", f"{archive}", f"--data={folder}"], ["verify", f"{archive}"]):
        result = runner.invoke(app, ["backup", *arguments])
        assert result.exit_code == 0, result.stderr
        assert f"they stay in {BUCKET}" in result.stderr
        assert "0 files" in result.stderr
    monkeypatch.delenv("MULTICAP_ARTIFACTS_URL")
    result = runner.invoke(app, ["backup", "restore", f"{archive}", f"--data={tmp_path / 'there'}"])
    assert (result.exit_code, "Set MULTICAP_ARTIFACTS_URL" in result.stderr) == (2, True)
    monkeypatch.setenv("MULTICAP_ARTIFACTS_URL", BUCKET)
    result = runner.invoke(app, ["backup", "restore", f"{archive}", f"--data={tmp_path / 'there'}"])
    assert result.exit_code == 0, result.stderr
    assert sorted(path.name for path in (tmp_path / "there").iterdir()) == ["artifacts", "multicap.db", "uploads"]


def test_commands_newer_database_is_refused(folder: Path) -> None:
    database = Database(f"sqlite:///{folder / 'multicap.db'}")
    with database.writing() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")
    database.close()
    result = runner.invoke(app, ["keys", "list", f"--data={folder}"])
    assert result.exit_code == 2
    assert "9999" in result.stderr
    assert "Traceback" not in result.stderr
