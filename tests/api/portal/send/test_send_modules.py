"""Modules of the view Send without a browser."""

from pathlib import Path

from tests.api.portal.node import run_by_node

HERE = Path(__file__).parent
CASES = HERE.parents[2] / "pipeline" / "capture"


def test_matching() -> None:
    run_by_node(HERE / "matching.test.mjs", CASES)
