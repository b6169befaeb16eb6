"""Formats of an example package that is installed beside Multicap."""

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
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


_JOINTS = """
import json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import multicap
from pipeline.capture.keypoints_zip import unpack_keypoints
folder = Path(sys.argv[2])
keypoints = unpack_keypoints([folder / f"{name}.zip" for name in json.loads(sys.argv[3])], folder / "unpacked")
session = multicap.open_keypoints(keypoints, folder / "calibration.json", frame_rate_hz=25.0)
forms = [finding.evidence["forms"] for finding in session.findings if finding.code == "keypoints_form"]
joints = {name: detections.keypoints_px.tolist() for name, detections in session.detections.items()}
print(json.dumps([forms, session.layout.name, joints]))
"""


def test_keypoints_of_package_are_read(package: Path, tmp_path: Path) -> None:
    simulation = record(replace(SCENES["room"], duration_s=1.0), 1, 3)
    write_simulation(simulation, tmp_path)
    (tmp_path / "unpacked").mkdir()
    for name, detections in simulation.detections.items():
        points = np.concatenate([detections.keypoints_px, detections.score[..., None]], axis=-1)
        lines = [f"{frame} {' '.join(map(str, points[k].ravel()))}" for k, frame in enumerate(detections.frame)]
        with zipfile.ZipFile(tmp_path / f"{name}.zip", "w") as archive:
            archive.writestr("take.joints", "\n".join(lines))
    names = json.dumps(list(simulation.detections))
    forms, layout, joints = json.loads(run(_JOINTS, str(package), str(tmp_path), names))
    assert (forms, layout) == ([["Studio"]], "coco-17")
    for name, detections in simulation.detections.items():
        seen = np.isfinite(detections.keypoints_px).all(-1).any(-1)
        np.testing.assert_allclose(np.array(joints[name], float), detections.keypoints_px[seen], atol=1e-9)


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a package whose reader and writer can't be imported."""
    folder = tmp_path_factory.mktemp("broken")
    (folder / "broken-1.dist-info").mkdir()
    (folder / "broken-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1\n")
    points = "[multicap.writers]\nnothing = missing:FORMAT\n[multicap.readers]\nneither = missing:read\n"
    (folder / "broken-1.dist-info" / "entry_points.txt").write_text(points)
    return folder


def sentence(name: str, group: str) -> str:
    message = f"The format {name} of broken ({group}) can't be loaded: No module named 'missing'."
    return f"{message} Update broken, or uninstall it."


def ended(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"}
    return subprocess.run(
        [sys.executable, "-P", *command], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["check", "--help"], sentence("nothing", "multicap.writers")),
        (["serve", "--help"], ""),
    ],
)
def test_broken_package_ends_command_but_service(broken: Path, words: list[str], expected: str) -> None:
    done = ended(broken, "-m", "api.cli.start", *words)
    assert done.returncode == (1 if expected else 0), done.stderr
    if expected:
        assert done.stderr.strip() == expected
    else:
        assert sentence("nothing", "multicap.writers") in done.stderr


def test_service_logs_broken_reader_and_reads_others(broken: Path) -> None:
    program = """
from worker.run.logs import configure_logs
configure_logs()
from pipeline.calibration.registry import calibration_readers
from pipeline.capture.keypoint_files.forms import keypoint_readers
print(len(calibration_readers()), len(keypoint_readers()))
"""
    done = ended(broken, "-c", program)
    assert [int(word) > 9 for word in done.stdout.split()] == [True, True]
    (line,) = [json.loads(line) for line in done.stderr.splitlines() if "multicap.readers" in line]
    assert sentence("neither", "multicap.readers") in line["event"]
    assert line["level"] == "warning"
