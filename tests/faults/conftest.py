"""Fixtures of the fault tests: a short capture of keypoints, and the library's results."""

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import Method, ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.e2e.serving import digests
from tests.pipeline.simulations import write_simulation

METHODS: tuple[Method, ...] = ("tracking", "clustering")


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("room"), duration_s=6.0), 3, 4), folder)
    return folder


@pytest.fixture(scope="session")
def undisturbed(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[Method, dict[str, str]]:
    """SHA-256 of each result file that the library writes."""
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    found = {}
    for method in METHODS:
        folder = tmp_path_factory.mktemp(method)
        write_results(reconstruct(session, ReconstructionConfig(method=method)), folder)
        found[method] = digests(folder)
    return found
