"""Damaged database of a running service and of commands: clear messages, no stack trace, no 500."""

import json
from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from api.web.settings import Settings
from tests.api.conftest import form, problem_of, running
from tests.api.processes import serving
from tests.worker.store.backups import stopped_service
from tests.worker.store.damage import DAMAGES, copy_of, damage_under

COMMANDS = (["serve", "--port=0"], ["keys", "list"], ["keys", "create", "x"], ["audit"], ["webhooks", "list"])

runner = CliRunner()


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DATABASE_URL", "ARTIFACTS_URL", "DATA_DIR"):
        monkeypatch.delenv(f"MULTICAP_{name}", raising=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stopped_service(tmp_path_factory.mktemp("whole") / "data")


# Each damage with one of the commands: all of them open the database in the same way.
@pytest.mark.parametrize(
    ("damage", "command"),
    [
        pytest.param(DAMAGES[name], command, id=f"{name}-{' '.join(command)}")
        for name, command in zip(DAMAGES, cycle(COMMANDS))
    ],
)
def test_commands_say_which_file_is_damaged_and_what_to_do(
    whole: Path, tmp_path: Path, damage: Callable[[Path], None], command: list[str]
) -> None:
    database = copy_of(whole, tmp_path / "my data")
    damage(database)
    result = runner.invoke(app, [*command, f"--data={database.parent}"])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert f"The database {database} is damaged: " in result.stderr
    assert f"multicap backup restore BACKUP.tar --data '{tmp_path / 'my data-restored'}'" in result.stderr
    assert "Traceback" not in result.stderr
    assert isinstance(result.exception, SystemExit)


def test_backup_reports_it_as_json(whole: Path, tmp_path: Path) -> None:
    database = copy_of(whole, tmp_path / "data")
    DAMAGES["a page inverted"](database)
    arguments = ["backup", "create", f"{tmp_path / 'b.tar'}", f"--data={database.parent}"]
    result = runner.invoke(app, arguments)
    assert (result.exit_code, result.stdout) == (1, "")
    assert f"error The database {database} is damaged: " in result.stderr
    result = runner.invoke(app, [*arguments, "--json"])
    assert result.exit_code == 1
    (problem,) = json.loads(result.stdout)["problems"]
    assert problem["code"] == "database_damaged"
    assert str(database) in problem["message"]


def test_running_service_answers_503_with_code(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    with running(settings) as live:
        job_id = live.job_id()
        damage_under(settings.data_dir / "multicap.db")
        answers = [
            live.client.get("/v1/jobs"),
            live.client.get(f"/v1/jobs/{job_id}"),
            live.client.get(f"/v1/jobs/{job_id}/events"),
            live.client.get(f"/v1/jobs/{job_id}/results"),
            live.client.post("/v1/sessions", files=form()),
            live.client.post(f"/v1/jobs/{job_id}/cancel"),
            live.client.get("/metrics"),
        ]
        for answer in answers:
            problem = problem_of(answer, 503, "database_damaged")
            assert problem["retryable"]
            assert str(settings.data_dir) not in answer.text
            assert "retry-after" in answer.headers
        errors = problem_of(live.client.get("/readyz"), 503, "not_ready")["errors"]
        assert "database_damaged" in {item["code"] for item in errors}
        assert live.client.get("/healthz").is_success


def test_log_says_what_to_do_and_has_no_trace(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    with serving(settings) as (client, _):
        assert client.post("/v1/jobs", files=form()).status_code == 202
        damage_under(settings.data_dir / "multicap.db")
        assert {client.get("/v1/jobs").status_code for _ in range(3)} == {503}
    lines = [json.loads(line) for line in (settings.data_dir.parent / "log").read_text().splitlines()]
    said = [line for line in lines if line.get("code") == "database_damaged"]
    assert len(said) == 3
    assert str(settings.data_dir / "multicap.db") in said[0]["detail"]
    assert "multicap backup restore" in said[0]["instructions"]
    assert not any("exception" in line for line in lines)
