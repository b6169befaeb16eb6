"""All demos of the sample package run from their own files, by the command line."""

import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from pipeline.calibration.registry import read_calibration
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.storage import home
from tests.cases import accuracy_but

PACKAGE = "pose2sim-0.10.49-py3-none-any.whl"
NUM_FRAMES = 25
# Videos, calibration, and cameras whose calibration has other sizes than the video: 8 columns of the codec's padding.
DEMOS = {
    "Demo_SinglePerson": ("Demo_SinglePerson/videos", {"cam01", "cam02"}),
    "Demo_MultiPerson": ("Demo_MultiPerson/videos", set()),
    "Demo_Batch, trial 1": ("Demo_Batch/Trial_1/videos", {"cam01", "cam02"}),
    "Demo_Batch, trial 2": ("Demo_Batch/Trial_2/videos", set()),
}


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the package's demos."""
    samples.install()
    package = home() / "downloads" / PACKAGE
    if not package.is_file():
        pytest.skip(f"{PACKAGE} is not among the downloads")
    folder = tmp_path_factory.mktemp("package")
    with zipfile.ZipFile(package) as archive:
        wanted = [name for name in archive.namelist() if name.startswith("Pose2Sim/Demo_")]
        archive.extractall(folder, [name for name in wanted if name.endswith((".mp4", "_int.jpg", "Calib.qca.txt"))])
    return folder / "Pose2Sim"


@pytest.mark.slow
@pytest.mark.parametrize("demo", accuracy_but(["Demo_SinglePerson", "Demo_MultiPerson"], DEMOS))
def test_demo(demos: Path, tmp_path: Path, demo: str) -> None:
    videos, padded = DEMOS[demo]
    calibration = demos / videos.split("/")[0] / "calibration" / "Calib.qca.txt"
    words = ["--videos", str(demos / videos), "--calibration", str(calibration), "--out", str(tmp_path / "out")]
    words += ["--profile", "fast", "--frames", f"0:{NUM_FRAMES}"]
    command = [sys.executable, "-P", "-m", "multicap", "reconstruct", *words, "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    result = json.loads(ended.stdout)
    assert {warning["camera"] for warning in result["warnings"] if warning["severity"] == "warning"} == padded
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["num_frames"] == NUM_FRAMES
    # Of all 100 frames 8.8 and 10.9 px were measured.
    assert metrics["reprojection_error_px"]["median"] < 15
    assert metrics["coverage"] > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("cameras", accuracy_but(["cam01"], ["cam01", "cam01 cam02 cam03 cam04"]))
def test_photographs_of_chessboard_give_focal_lengths(demos: Path, tmp_path: Path, cameras: str) -> None:
    folder = demos / "Demo_SinglePerson" / "calibration"
    for name in cameras.split():
        shutil.copytree(folder / "intrinsics" / f"int_{name}_img", tmp_path / "images" / f"int_{name}_img")
    words = ["--images", str(tmp_path / "images"), "--board", "chessboard:4x7:0.06"]
    words += ["--out", str(tmp_path / "made.json")]
    command = [sys.executable, "-P", "-m", "multicap", "calibrate", "board", *words, "--json"]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    given = {camera.name: camera for camera in read_calibration(folder / "Calib.qca.txt")}
    made = json.loads(ended.stdout)
    assert not made["has_extrinsics"]
    assert {camera["name"] for camera in made["cameras"]} == set(cameras.split())
    for camera in made["cameras"]:
        assert camera["focal_px"] == pytest.approx(given[camera["name"]].matrix[0, 0], rel=0.015)
        assert camera["reprojection_error_px"] < 0.4
