"""Modules of the view Send without a browser."""

from pathlib import Path

import pytest

from tests.api.portal.node import run_by_node

HERE = Path(__file__).parent
CASES = HERE.parents[2] / "pipeline" / "capture"


@pytest.mark.parametrize("module", ["chosen_files", "folders", "matching", "parts"])
def test_modules_of_view_send(module: str) -> None:
    run_by_node(HERE / f"{module}.test.mjs", CASES)
