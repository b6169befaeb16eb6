"""Data sets with truth, which a machine may have."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from api.cli.main import app

DATA = Path(__file__).parents[3] / "shared" / "data"


def folder_of(name: str) -> Path:
    """Folder of a data set; an environment variable may name another."""
    return Path(os.environ.get(f"MULTICAP_{name.upper()}", DATA / name))


def needs(name: str) -> pytest.MarkDecorator:
    """Skip a test on machines without a data set."""
    reason = f"no data set {name} at hand (MULTICAP_{name.upper()} names its folder)"
    return pytest.mark.skipif(not folder_of(name).is_dir(), reason=reason)


def evaluated(name: str, *options: str) -> dict[str, Any]:
    """Scores of `multicap evaluate` on a data set."""
    result = CliRunner().invoke(app, ["evaluate", name, f"--data={folder_of(name)}", *options, "--json"])
    assert result.exit_code == 0, result.output
    scores: dict[str, Any] = json.loads(result.stdout)
    return scores
