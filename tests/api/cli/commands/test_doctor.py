"""`multicap doctor` on a data folder with files that no row names."""

import json
from pathlib import Path

from typer.testing import CliRunner

from api.cli.main import app
from tests.worker.store.files.test_unneeded import id_of
from worker.store.files.artifacts import open_artifacts
from worker.store.files.file_keys import record_key

runner = CliRunner()


def test_orphans_are_listed_and_removed_if_asked_for(tmp_path: Path) -> None:
    healthy = runner.invoke(app, ["doctor", "--data", str(tmp_path)])
    assert (healthy.exit_code, "disk: ok" in healthy.stdout) == (0, True)
    session_id = id_of(hours_ago=48.0)
    open_artifacts("", tmp_path).put_bytes(record_key(session_id), b"pose")
    listed = runner.invoke(app, ["doctor", "--data", str(tmp_path), "--json"])
    assert (listed.exit_code, json.loads(listed.stdout)["orphans"]) == (1, [f"sessions/{session_id}/"])
    removed = runner.invoke(app, ["doctor", "--data", str(tmp_path), "--remove"])
    assert removed.exit_code == 0
    assert "1 folders belong to no session" in removed.stdout
