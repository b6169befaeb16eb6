"""`multicap help`: topics, a page, and a topic that there is not."""

import pytest
from typer.testing import CliRunner

from api.cli.main import app
from api.web.help import FOLDER

pytestmark = pytest.mark.skipif(not (FOLDER / "topics.json").is_file(), reason="needs `make docs`")


def test_topics_are_listed() -> None:
    result = CliRunner().invoke(app, ["help"])
    assert result.exit_code == 0
    assert "calibration" in result.stdout


def test_page_is_printed() -> None:
    result = CliRunner().invoke(app, ["help", "calibration"])
    assert result.exit_code == 0
    assert result.stdout.startswith("# ")


def test_misspelt_topic_names_similar_ones() -> None:
    result = CliRunner().invoke(app, ["help", "calibraton"])
    assert result.exit_code == 2
    assert "Similar: calibration" in result.stderr
