"""Examples in docstrings of the plan, of stages, of the tracker and of clustering."""

import doctest
from importlib import import_module

import pytest


@pytest.mark.parametrize(
    "module",
    [
        "pipeline.run.engine.plan",
        "pipeline.run.engine.stage",
        "pipeline.association.tracking.track_people",
        "pipeline.association.clustering.cluster_people",
    ],
)
def test_examples_of_docstrings_hold(module: str) -> None:
    results = doctest.testmod(import_module(module))
    assert results.attempted > 0
    assert results.failed == 0
