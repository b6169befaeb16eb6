"""Calibration from a board against aniposelib and Caliscope on the same videos; `make verify-calibration` runs it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from api.cli.commands import calibrate
from pipeline.calibration.board.spec import parse_board
from pipeline.calibration.registry import read_calibration
from pipeline.geometry.camera import center_in_world
from tests.pipeline.calibration.board.conftest import ring
from tests.pipeline.calibration.board.filmed_boards import BoardPainter, board_poses
from tests.pipeline.media import write_pictures

PEERS = Path(__file__).parents[4] / ".venv-peers"
RUNNERS = Path(__file__).parent / "peers"
BOARD = parse_board("charuco:7x5:0.12:0.09:DICT_4X4_50")
CAMERAS = ring(4)
Found = dict[str, dict[str, object]]


def errors(found: Found) -> tuple[float, float]:
    """Largest distance of a camera from the truth after a rigid alignment, mm, and of a focal length, percent."""
    centers_m = np.array([found[camera.name]["center_m"] for camera in CAMERAS], float)
    truth_m = np.array([center_in_world(camera) for camera in CAMERAS])
    centred_m, goal_m = centers_m - centers_m.mean(0), truth_m - truth_m.mean(0)
    rotation, _ = Rotation.align_vectors(goal_m, centred_m)
    focal_px = np.array([found[camera.name]["focal_px"] for camera in CAMERAS], float)
    truth_px = np.array([camera.matrix[0, 0] for camera in CAMERAS])
    distance_mm = 1000 * np.linalg.norm(rotation.apply(centred_m) - goal_m, axis=1)
    return float(distance_mm.max()), float(100 * np.abs(focal_px / truth_px - 1).max())


@pytest.mark.slow
@pytest.mark.parametrize("seed", [21, 22])
def test_it_is_not_worse_than_others_on_same_videos(tmp_path: Path, seed: int) -> None:
    if not (PEERS / ".installed").is_file():
        pytest.skip("aniposelib and Caliscope are not installed (`make verify-calibration` does it)")
    videos, rng = tmp_path / "videos", np.random.default_rng(seed)
    videos.mkdir()
    _, poses = board_poses(CAMERAS, BOARD, 40, rng)
    for camera in CAMERAS:
        painter = BoardPainter(camera, BOARD)
        pictures = [painter.paint(pose, rng) for pose in poses]
        write_pictures(videos / f"{camera.name}.mp4", pictures, {"crf": "5", "preset": "ultrafast"})
    options = ["--board", str(BOARD), "--out", str(tmp_path / "ours.json"), "--videos", str(videos)]
    calibrate.app(["board", *options], standalone_mode=False)
    found: dict[str, Found] = {
        "ours": {
            camera.name: {"center_m": center_in_world(camera), "focal_px": camera.matrix[0, 0]}
            for camera in read_calibration(tmp_path / "ours.json")
        }
    }
    size = [str(value) for value in (BOARD.cols, BOARD.rows, BOARD.square_m, BOARD.marker_m)]
    for name in ("aniposelib", "caliscope"):
        out = tmp_path / f"{name}.json"
        program = [str(PEERS / "bin" / "python"), str(RUNNERS / f"run_{name}.py"), str(videos), str(out), *size]
        subprocess.run(program, check=True, timeout=600, capture_output=True)
        found[name] = json.loads(out.read_text())
    measured = {name: errors(of) for name, of in found.items()}
    for name, (distance_mm, focal_percent) in measured.items():
        sys.stdout.write(f"{name}: positions {distance_mm:.1f} mm, focal lengths {focal_percent:.2f} %\n")
    for peer in ("aniposelib", "caliscope"):
        assert measured["ours"][0] <= measured[peer][0]
        assert measured["ours"][1] <= measured[peer][1]
