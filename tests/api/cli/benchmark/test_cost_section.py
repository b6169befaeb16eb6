"""Costs in docs/measurements.md are those of docs/cost.json."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from api.cli.benchmark.cost import cost_section
from api.cli.benchmark.cost.cost_section import BEGIN, END, MEASURED, PAGE, document, main, section


@pytest.fixture
def cost() -> dict[str, Any]:
    """Document that was measured."""
    measured: dict[str, Any] = json.loads(MEASURED.read_text(encoding="utf-8"))
    return measured


def test_the_page_has_the_measured_costs(cost: dict[str, Any]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == document()
    assert section(cost) in page


def test_another_number_is_another_page(cost: dict[str, Any]) -> None:
    for key, change in (("core_s", 1.5), ("peak_mib", 900.0)):
        changed = copy.deepcopy(cost)
        changed["length"][0][key] += change
        assert section(changed) != section(cost)


def test_a_page_that_differs_is_told_and_written_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "measurements.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    monkeypatch.setattr(cost_section, "PAGE", page)
    assert main(["--check"]) == 1
    assert main([]) == 0
    assert main(["--check"]) == 0
    written = page.read_text(encoding="utf-8")
    assert "\nold\n" not in written
    assert written.startswith(f"before\n{BEGIN}\n")
    assert written.endswith(f"\n{END}\nafter\n")


def test_a_page_without_the_place_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "measurements.md"
    page.write_text(f"before\n{BEGIN}\n")
    monkeypatch.setattr(cost_section, "PAGE", page)
    with pytest.raises(ValueError, match=r"measurements\.md lacks the lines"):
        main([])
