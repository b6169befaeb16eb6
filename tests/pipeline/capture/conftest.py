"""A simulated capture, and its folder of keypoints."""

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.simulations import write_simulation


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("unsynchronised"), duration_s=1.0), seed=4, num_views=3)


@pytest.fixture
def scene(simulation: Simulation, tmp_path: Path) -> Path:
    write_simulation(simulation, tmp_path)
    return tmp_path
