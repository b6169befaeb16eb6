"""Human3.6M as downloaded: positions in CDF, scores from keypoints, and folders that can't be used."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.data.people import Source, Track3D
from pipeline.validation.evaluation.datasets import human36m
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.validation.evaluation.datasets.openpose_files import write_keypoints

cdflib = pytest.importorskip("cdflib", reason="the extra `evaluation` has it")

ACTION = "Directions 1"
CAMERAS = ("54138969", "55011271", "58860488", "60457274")
# Places of the data set's joints: side, then hip, knee, ankle, shoulder, elbow and wrist.
PLACES = {"right": (1, 2, 3, 25, 26, 27), "left": (6, 7, 8, 17, 18, 19)}
LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    scene = find_scene("room")
    clock = replace(scene.clock, frame_rate_hz=50.0)
    return record(replace(scene, duration_s=2.0, clock=clock, cast=Cast(1, (3.0, 3.0))), seed=4)


@pytest.fixture(scope="module")
def written(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("human36m") / "S9"
    names = {camera.name: name for camera, name in zip(simulation.cameras, CAMERAS, strict=False)}
    write_keypoints(folder / "keypoints", simulation, names)
    lenses, poses = {}, {}
    for camera, name in zip(simulation.cameras, names.values(), strict=True):
        lens = {"calibration_matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist()}
        lenses[name] = lens | {"image_width": camera.size_px[0], "image_height": camera.size_px[1]}
        centred = (1000.0 * camera.cam_from_world.translation_m).reshape(3, 1).tolist()
        poses[name] = {"R": camera.cam_from_world.rotation.tolist(), "t": centred}
    cameras = {"intrinsics": lenses, "extrinsics": {"S1": {}, "S9": poses}}
    (folder / "camera-parameters-S9.json").write_text(json.dumps(cameras), encoding="utf-8")
    write_positions(folder, positions_mm(simulation))
    return folder


def positions_mm(simulation: Simulation) -> np.ndarray:
    """32 joints of the simulated person; all without a place are far away."""
    xyz_mm = 1000.0 * simulation.truth_m[0]
    positions = np.full((len(xyz_mm), 32, 3), 5e4)
    for side, places in PLACES.items():
        positions[:, places] = xyz_mm[:, simulation.joints.indices(tuple(f"{side}_{limb}" for limb in LIMBS))]
    positions[:, 0] = (positions[:, 1] + positions[:, 6]) / 2
    return positions


def write_positions(folder: Path, positions: np.ndarray, name: str = "Pose", action: str = ACTION) -> Path:
    """Write positions like the data set: one record of frames x 96 millimetres."""
    path = folder / "MyPoseFeatures" / "D3_Positions" / f"{action}.cdf"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    numbers = positions.reshape(1, len(positions), -1).astype(np.float32)
    spec = {"Variable": name, "Data_Type": 21, "Num_Elements": 1, "Rec_Vary": True, "Compress": 6}
    file = cdflib.cdfwrite.CDF(str(path), cdf_spec={"Compressed": 0})
    file.write_var(spec | {"Dim_Sizes": list(numbers.shape[1:])}, var_data=numbers)
    file.close()
    return path


def run(folder: Path, *options: str, action: str = ACTION) -> tuple[int, dict[str, Any]]:
    calibration = folder / "camera-parameters-S9.json"
    command = ["evaluate", "human36m", f"--data={folder}", f"--action={action}", f"--calibration={calibration}"]
    result = CliRunner().invoke(app, [*command, "--json", *options])
    return result.exit_code, json.loads(result.stdout)


def track_of(xyz_m: np.ndarray) -> Track3D:
    shape = xyz_m.shape[:2]
    return Track3D(1, 0, xyz_m, np.ones(shape), np.full(shape, Source.MEASURED), np.ones(shape), np.full(shape, 4))


def scores_of(simulation: Simulation, written: Path, xyz_m: np.ndarray) -> dict[str, Any]:
    _, truth_m = human36m.load_human36m(written, ACTION, has_footage=False)
    times = {frame: simulation.timebase.time_s(frame) for frame in range(simulation.timebase.num_frames)}
    tracks = [track_of(xyz_m)]
    return human36m.score_human36m(tracks, simulation.joints, simulation.timebase, truth_m, times)


def test_true_positions_have_no_error(simulation: Simulation, written: Path) -> None:
    scores = scores_of(simulation, written, simulation.truth_m[0])
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-2)
    assert scores["pa_mpjpe_mm"] == pytest.approx(0.0, abs=1e-2)
    assert (scores["frames"], scores["pck150"], scores["recall"]) == (100, 1.0, 1.0)


def test_procrustes_takes_away_turn_shift_and_scale(simulation: Simulation, written: Path) -> None:
    turn = Rotation.from_euler("z", 10, degrees=True).as_matrix()
    middle_m = simulation.truth_m[0].mean(1, keepdims=True)
    moved_m = 1.1 * (simulation.truth_m[0] - middle_m) @ turn.T + middle_m + np.array([0.1, 0.0, 0.0])
    scores = scores_of(simulation, written, moved_m)
    assert scores["mpjpe_mm"] > 90.0
    assert scores["pa_mpjpe_mm"] == pytest.approx(0.0, abs=1e-2)


def test_procrustes_keeps_error_of_one_joint(simulation: Simulation, written: Path) -> None:
    xyz_m = simulation.truth_m[0].copy()
    xyz_m[:, simulation.joints.index("left_wrist"), 2] += 0.13
    scores = scores_of(simulation, written, xyz_m)
    assert scores["mpjpe_mm"] == pytest.approx(10.0, abs=1e-2)
    assert 5.0 < scores["pa_mpjpe_mm"] < 20.0


def test_keypoints_are_reconstructed_and_scored(written: Path) -> None:
    code, scores = run(written, f"--keypoints={written / 'keypoints'}", "--frames=10:60")
    assert code == 0
    assert (scores["frames"], scores["recall"], scores["switches"]) == (50, 1.0, 0)
    assert 0.0 < scores["pa_mpjpe_mm"] < scores["mpjpe_mm"] < 40.0


def test_videos_of_other_actions_are_left_out(written: Path, tmp_path: Path) -> None:
    path = tmp_path / "MyPoseFeatures" / "D3_Positions" / f"{ACTION}.cdf"
    path.parent.mkdir(parents=True)
    path.write_bytes((written / "MyPoseFeatures" / "D3_Positions" / f"{ACTION}.cdf").read_bytes())
    (tmp_path / "Videos").mkdir()
    for name in ("Directions", ACTION, "_ALL", "Directions 10"):
        (tmp_path / "Videos" / f"{name}.54138969.mp4").touch()
    videos, truth_m = human36m.load_human36m(tmp_path, ACTION)
    assert [video.name for video in videos] == ["Directions 1.54138969.mp4"]
    assert truth_m.shape == (100, 13, 3)


def test_all_that_is_missing_is_reported_at_once(written: Path, tmp_path: Path) -> None:
    code, answer = run(tmp_path, action="Eating")
    assert (code, [problem["file"] for problem in answer["problems"]]) == (2, ["Eating.*.mp4", "Eating.cdf"])
    code, answer = run(written, f"--keypoints={written / 'keypoints'}", action="Eating")
    assert [problem["hint"] for problem in answer["problems"]] == ["Give one of Directions 1 by --action."]


@pytest.mark.parametrize("damage", ["text", "cut", "name", "joints", "far"])
def test_damaged_positions_are_reported(simulation: Simulation, tmp_path: Path, damage: str) -> None:
    positions = positions_mm(simulation)
    path = write_positions(tmp_path, positions)
    match damage:
        case "text":
            path.write_text("no CDF")
        case "cut":
            path.write_bytes(path.read_bytes()[:600])
        case "name":
            write_positions(tmp_path, positions, name="Angles")
        case "joints":
            write_positions(tmp_path, positions[:, :25])
        case "far":
            write_positions(tmp_path, 1e3 * positions)
    code, answer = run(tmp_path, "--keypoints=unread")
    (problem,) = answer["problems"]
    reason = "a position is kilometres away" if damage == "far" else "damaged, or in another format"
    assert (code, problem["message"]) == (2, f"The positions can't be read: {reason}.")


def test_missing_package_is_named(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(human36m, "find_spec", lambda _: None)
    code, answer = run(written, f"--keypoints={written / 'keypoints'}")
    assert code != 0
    assert "pip install multicap[evaluation]" in json.dumps(answer)
