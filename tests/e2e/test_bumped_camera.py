"""A camera that is moved in the middle of a take, through the whole pipeline; good takes have no such warning."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.data.arrays import read_only
from pipeline.core.data.cameras import Camera, FrameTimes
from pipeline.geometry.camera import bend
from pipeline.geometry.undistortion import undistort_px
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.cases import accuracy_but
from tests.pipeline.simulations import write_simulation

pytestmark = pytest.mark.slow

# The take begins two minutes after the clock does, and the camera is moved 14 s later.
START_S, BUMP_S, DURATION_S = 120.0, 134.3, 28.0
BUMPED = "cam_02"
TURN_DEG = 2.0


def turned_px(camera: Camera, points_px: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Pixels of the same directions after the camera turned about its own centre."""
    turn = Rotation.from_rotvec(np.radians([0.6, 0.8, 0.0]) * TURN_DEG).as_matrix()
    ideal_px = undistort_px(camera, points_px)
    directions = np.concatenate([ideal_px, np.ones_like(ideal_px[..., :1])], axis=-1) @ np.linalg.inv(camera.matrix).T
    turned = directions @ turn.T
    return bend(camera, turned[..., :2] / turned[..., 2:]) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def take(scene: str, seed: int, num_views: int = 4) -> Simulation:
    """Simulated take on a clock on which it begins after two minutes."""
    simulation = record(replace(find_scene(scene), duration_s=DURATION_S), seed, num_views)
    times = {name: FrameTimes(read_only(START_S + own.time_s)) for name, own in simulation.times.items()}
    return replace(simulation, times=times)


def bumped(simulation: Simulation) -> Simulation:
    """The take with one camera turned from a moment on; its calibration is that of the beginning."""
    camera = next(one for one in simulation.cameras if one.name == BUMPED)
    found = simulation.detections[BUMPED]
    is_after = simulation.times[BUMPED].time_s[found.frame] >= BUMP_S
    points_px = np.where(is_after[:, None, None], turned_px(camera, found.keypoints_px), found.keypoints_px)
    moved = replace(found, keypoints_px=read_only(points_px))
    return replace(simulation, detections={**simulation.detections, BUMPED: moved})


def reconstructed(simulation: Simulation, folder: Path) -> dict[str, Any]:
    """Metrics of ``multicap reconstruct --refine-calibration auto``."""
    write_simulation(simulation, folder)
    words = ["reconstruct", "--keypoints", str(folder / "keypoints"), "--calibration", str(folder / "calibration.json")]
    words += ["--timestamps", str(folder / "timestamps.csv"), "--out", str(folder / "out"), "--no-cache"]
    result = CliRunner().invoke(
        app, [*words, "--refine-calibration=auto", "--smoothing=none", "--exports=csv", "--json"]
    )
    assert result.exit_code == 0, result.output
    metrics: dict[str, Any] = json.loads(result.stdout)["metrics"]
    return metrics


@pytest.mark.parametrize("seed", accuracy_but([1], [1, 2]))
def test_bumped_camera_is_named_with_its_time(tmp_path: Path, seed: int) -> None:
    metrics = reconstructed(bumped(take("room", seed)), tmp_path)
    warnings = {check["code"]: check["message"] for check in metrics["capture_checks"]}
    assert f"{BUMPED} from 02:14 on (" in warnings["camera_bumped"]
    (bump,) = metrics["calibration"]["bumped"]
    assert bump["camera"] == BUMPED
    assert bump["time_s"] == pytest.approx(BUMP_S, abs=0.3)
    assert bump["rotation_deg"] == pytest.approx(TURN_DEG, rel=0.2)


@pytest.mark.parametrize(
    ("scene", "seed"),
    accuracy_but([("room", 1)], [("room", 1), ("room", 3), ("store", 1), ("comings-and-goings", 2)]),
)
def test_good_take_has_no_bumped_camera(tmp_path: Path, scene: str, seed: int) -> None:
    metrics = reconstructed(take(scene, seed), tmp_path)
    assert metrics["calibration"]["bumped"] == []
    assert metrics["calibration"]["world"] is None
    assert not metrics["calibration"]["refined"]
    assert {check["code"] for check in metrics["capture_checks"]} <= {
        "calibration_kept",
        "few_views",
        "uncertain_identity",
    }
