"""Examples of `docs/reference/python.md`, run as they are written: in this process, and with a service."""

import re
from pathlib import Path
from typing import Any

import pytest

from pipeline.core.runtime.packages.samples import Sample
from tests.e2e.serving import Served, digests

pytestmark = pytest.mark.xdist_group("service")

PAGE = Path(__file__).parents[2] / "docs/reference/python.md"
ADDRESS = "http://127.0.0.1:8000"


def test_examples_of_page(
    sample: Sample, served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text(encoding="utf-8")
    assert text.count(ADDRESS) == 1
    names: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        exec(block.replace(ADDRESS, str(served.client.base_url)), names)  # noqa: S102 - our own page
    assert names["session"].timebase.num_frames == 100
    found = digests(tmp_path / "results")
    assert {"skeletons.json", "metrics.json", "person-1.bvh", "person-2.trc"} <= found.keys()
    assert digests(tmp_path / "downloaded") == found
    assert {"report.html", "skeletons.json", "metrics.json", "person-1.bvh"} <= digests(tmp_path / "take").keys()
    said = capsys.readouterr().out
    assert "100 frames at 60.0 Hz" in said
    assert "succeeded: 100%" in said
    assert "missing.mp4" in said
