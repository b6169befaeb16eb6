"""Examples in docstrings run and give what they show."""

import doctest
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.options.file_formats import is_installed
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.media import write_pictures
from tests.pipeline.simulations import write_simulation

ROOT = Path(__file__).parents[2]
EXAMPLES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text(encoding="utf-8").count(">>> ")
    - path.read_text(encoding="utf-8").count("# doctest: +SKIP")
    for path in sorted((ROOT / "pipeline").rglob("*.py"))
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Capture of three cameras: videos, keypoints and a calibration."""
    folder = tmp_path_factory.mktemp("capture")
    simulation = record(replace(find_scene("room"), duration_s=0.4), 0, 3)
    write_simulation(simulation, folder)
    (folder / "videos").mkdir()
    for camera in simulation.cameras:
        width, height = camera.size_px
        picture = np.zeros((height, width, 3), np.uint8)
        write_pictures(folder / "videos" / f"{camera.name}.mp4", [picture] * 3, {"preset": "ultrafast"})
    return folder


@pytest.mark.parametrize("name", [name for name, count in EXAMPLES.items() if count > 0])
def test_examples_of_module_give_their_results(name: str, folder: Path) -> None:
    if name.endswith(".usd") and not is_installed("usd"):
        pytest.skip("the package usd-core is not installed")
    failed, tried = doctest.testmod(import_module(name), extraglobs={"folder": folder})
    assert tried == EXAMPLES[name]
    assert not failed
