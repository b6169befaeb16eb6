"""Formats of an example package that is installed beside Multicap."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.validation.simulation.scenes import SCENES, record
from tests.pipeline.simulations import write_simulation

ROOT = Path(__file__).parents[2]
_PROGRAM = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from pipeline.core.options.config import CHOICES
from pipeline.core.options.file_formats import FILE_FORMATS
science = {"numpy", "scipy"} & sys.modules.keys()
import multicap
folder = Path(sys.argv[2])
session = multicap.open_keypoints(folder / "keypoints", folder / "calibration.json", folder / "timestamps.csv")
written = multicap.reconstruct_to_files(session, folder / "out", multicap.ReconstructionConfig(exports=("hips",)))
values = CHOICES["exports"].values["hips"].label, FILE_FORMATS["hips"].ending
print(json.dumps([sorted(science), values, written.metrics["exports"]["hips"], [p.name for p in written.paths]]))
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("package")
    options = ["--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--no-compile", "--target", str(folder)]
    command = [sys.executable, "-P", "-m", "pip", "install", *options, str(ROOT / "tests" / "plugins" / "example")]
    subprocess.run(command, check=True, capture_output=True)
    return folder


def run(program: str, *words: str) -> str:
    command = [sys.executable, "-P", "-c", program, *words]
    environment = {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_format_of_package_is_written(package: Path, tmp_path: Path) -> None:
    write_simulation(record(replace(SCENES["room"], duration_s=1.0), 1, 3), tmp_path)
    science, values, found, names = json.loads(run(_PROGRAM, str(package), str(tmp_path)))
    assert science == []
    assert values == ["CSV, path of the hips", "hips.csv"]
    assert found["max_distance_mm"] < 0.01
    assert "person-1.hips.csv" in names


_READING = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from pipeline.calibration.registry import read_contents
contents = read_contents(Path(sys.argv[2]))
print(json.dumps([contents.format, [[each.name, each.size_px, each.cam_from_world.translation_m.tolist()]
      for each in contents.cameras]]))
"""


def test_calibration_of_package_is_read(package: Path, tmp_path: Path) -> None:
    path = tmp_path / "rig.studio"
    path.write_text("left 900 1280 720 0 1.5 -4\nright 900 1280 720 1 1.5 -4\n", encoding="utf-8")
    name, cameras = json.loads(run(_READING, str(package), str(path)))
    assert name == "Studio"
    assert cameras == [["left", [1280, 720], [0.0, -1.5, 4.0]], ["right", [1280, 720], [-1.0, -1.5, 4.0]]]


def test_package_that_fails_to_load_is_named(package: Path, tmp_path: Path) -> None:
    (tmp_path / "broken-1.dist-info").mkdir()
    (tmp_path / "broken-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1\n")
    (tmp_path / "broken-1.dist-info" / "entry_points.txt").write_text("[multicap.writers]\nnothing = missing:FORMAT\n")
    program = """
import sys
sys.path.insert(0, sys.argv[1])
try:
    import pipeline.core.options.config
except ImportError as error:
    print(error)
"""
    said = run(program, str(tmp_path))
    assert said.strip() == "nothing of broken (multicap.writers) can't be loaded: No module named 'missing'"
