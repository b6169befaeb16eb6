"""Words of the view of a job: Node runs the tests in this folder."""

import json
from pathlib import Path

import pytest

from pipeline.export.scene import color_rgb
from tests.api.portal.node import run_by_node

NUM_COLOURS = 500


@pytest.mark.parametrize("module", ["corrections", "people", "states", "titles"])
def test_modules_of_view_of_job(module: str, tmp_path: Path) -> None:
    colours = {number: "#{:02x}{:02x}{:02x}".format(*color_rgb(number)) for number in range(1, NUM_COLOURS + 1)}
    (tmp_path / "colours.json").write_text(json.dumps(colours), encoding="utf-8")
    run_by_node(Path(__file__).with_name(f"{module}.test.mjs"), tmp_path)
