"""Accuracy on a rendered capture with exact truth; skipped without its folder."""

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.main import app

FOLDER = Path(os.environ.get("MULTICAP_RENDERED", Path(__file__).parents[3] / "shared" / "data" / "rendered"))


@pytest.mark.skipif(not FOLDER.is_dir(), reason="no rendered capture at hand (MULTICAP_RENDERED names its folder)")
def test_rendered_people() -> None:
    result = CliRunner().invoke(app, ["evaluate", "rendered", f"--data={FOLDER}", "--json"])
    assert result.exit_code == 0, result.output
    scores = json.loads(result.stdout)
    assert scores["mpjpe_mm"] <= 47
    assert scores["pck150"] >= 0.95
    assert scores["recall"] >= 0.97
    assert scores["switches"] == 0
    assert scores["ghost_rate"] <= 0.03
