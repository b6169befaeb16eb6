"""Accuracy on a rendered capture with exact truth; skipped without its folder."""

from tests.e2e.datasets import evaluated, needs


@needs("rendered")
def test_rendered_people() -> None:
    scores = evaluated("rendered")
    assert scores["mpjpe_mm"] <= 47
    assert scores["pck150"] >= 0.95
    assert scores["recall"] >= 0.97
    assert scores["switches"] == 0
    assert scores["ghost_rate"] <= 0.03
