"""Examples of `docs/start/live.md`, run as they are written."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.validation.simulation.scenes import SCENES, record
from tests.pipeline.simulations import write_simulation

PAGE = Path(__file__).parents[4] / "docs/start/live.md"


def test_examples_of_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    write_simulation(record(replace(SCENES["room"], duration_s=1.0), 0), tmp_path)
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    for block in re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        exec(block, {})  # noqa: S102 - our own page
    said = capsys.readouterr().out
    assert "0.92 s: person 3, nose at" in said
    assert "LiveCounts(taken=100, late=0, dropped=0)" in said
