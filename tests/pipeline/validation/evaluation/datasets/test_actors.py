"""Shelf and Campus as published: MATLAB's truth, scores from keypoints, and folders that can't be used."""

import json
import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.datasets import actors
from pipeline.validation.evaluation.pcp import benchmark_joints
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.validation.evaluation.datasets.openpose_files import write_keypoints

# Images of a short capture, in place of the data set's hundreds.
TESTED = (range(13, 30), range(40, 60))
FIRST = 10


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=2.4), seed=5)


@pytest.fixture(scope="module")
def written(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("CampusSeq1")
    write_calibration(folder, simulation)
    names = {camera.name: f"Camera{number}" for number, camera in enumerate(simulation.cameras)}
    write_keypoints(folder / "keypoints", simulation, names, FIRST)
    write_truth(folder, cells_of(simulation))
    return folder


@pytest.fixture(autouse=True)
def short_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actors, "TESTED", {"campus": TESTED, "shelf": (range(13, 60),)})


def write_calibration(folder: Path, simulation: Simulation) -> None:
    """Write the cameras in VoxelPose's form, with the centre of the camera in millimetres, and with sizes."""
    cameras = {}
    for number, camera in enumerate(simulation.cameras):
        pose, matrix = camera.cam_from_world, camera.matrix
        distortion = camera.distortion.tolist()
        cameras[str(number)] = {
            "R": pose.rotation.tolist(),
            "T": (-1000.0 * pose.rotation.T @ pose.translation_m).reshape(3, 1).tolist(),
            **dict(zip(("fx", "fy", "cx", "cy"), matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(), strict=True)),
            "k": [[distortion[0]], [distortion[1]], [distortion[4]]],
            "p": [[distortion[2]], [distortion[3]]],
            "image_width": camera.size_px[0],
            "image_height": camera.size_px[1],
        }
    (folder / "calibration_campus.json").write_text(json.dumps(cameras), encoding="utf-8")


def cells_of(simulation: Simulation) -> list[list[Any]]:
    """Poses of each actor by image: image 10 is the first frame; actor 1 is not annotated in images 20 and 21."""
    truth_m = benchmark_joints(simulation.truth_m)
    absent = [np.empty((1, 0))] * FIRST
    cells = [[*absent, *[pose if np.isfinite(pose).all() else 0.0 for pose in actor]] for actor in truth_m]
    cells[0][20], cells[0][21] = 0.0, np.empty((0, 0))
    return cells


def write_truth(folder: Path, cells: list[list[Any]], name: str = "actor3D", is_compressed: bool = True) -> Path:
    """Write actors as nested cells, like the published files."""
    outer = np.empty((1, len(cells)), object)
    for number, actor in enumerate(cells):
        inner = np.empty((len(actor), 1), object)
        for image, pose in enumerate(actor):
            inner[image, 0] = pose
        outer[0, number] = inner
    folder.mkdir(parents=True, exist_ok=True)
    savemat(folder / "actorsGT.mat", {name: outer, "actor2D": outer}, do_compression=is_compressed)
    return folder / "actorsGT.mat"


def run(folder: Path, *options: str, name: str = "campus") -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(app, ["evaluate", name, f"--data={folder}", "--json", *options])
    return result.exit_code, json.loads(result.stdout)


def problems_of(folder: Path, *options: str, name: str = "campus") -> list[dict[str, Any]]:
    code, answer = run(folder, *options, name=name)
    assert code == 2
    problems: list[dict[str, Any]] = answer["problems"]
    return problems


@pytest.mark.parametrize("is_compressed", [True, False])
def test_truth_has_annotated_poses_of_tested_images(
    simulation: Simulation, tmp_path: Path, is_compressed: bool
) -> None:
    write_truth(tmp_path, cells_of(simulation), is_compressed=is_compressed)
    problems: list[Any] = []
    images, truth_m = actors.read_actor_truth(tmp_path, "campus", problems)
    assert (images, problems) == (range(13, 60), [])
    np.testing.assert_array_equal(truth_m[1, 0], benchmark_joints(simulation.truth_m)[1, 3])
    annotated = np.isfinite(truth_m).all((-2, -1))
    assert [13 + k for k in np.flatnonzero(~annotated[0])] == [20, 21, *range(30, 40)]


def test_converted_truth_counts_in_place_of_matlabs(simulation: Simulation, tmp_path: Path) -> None:
    (tmp_path / "actorsGT.mat").write_bytes(b"damaged")
    truth_m = np.full((3, 60, 14, 3), np.nan, np.float32)
    truth_m[:, 10:] = benchmark_joints(simulation.truth_m)[:3, :50]
    np.savez(tmp_path / "gt.npz", gt=truth_m)
    problems: list[Any] = []
    _, read_m = actors.read_actor_truth(tmp_path, "shelf", problems)
    assert problems == []
    np.testing.assert_array_equal(read_m, truth_m[:, 13:60])


def test_keypoints_are_reconstructed_and_scored(written: Path) -> None:
    code, scores = run(written, f"--keypoints={written / 'keypoints'}")
    assert code == 0
    assert scores.keys() == {"method", "pcp", "mpjpe_mm", "pck150", "switches"}
    assert scores["pcp"]["by_head_rule"].keys() == {"crossview", "mvpose", "voxelpose", "ears"}
    assert min(scores["pcp"]["actors"]) > 99.0
    assert max(scores["mpjpe_mm"]) < 45.0
    assert scores["switches"] == 0


def test_truth_of_other_images_raises_the_error(simulation: Simulation, written: Path, tmp_path: Path) -> None:
    moved = [[pose + 0.1 if np.size(pose) > 1 else pose for pose in actor] for actor in cells_of(simulation)]
    write_truth(tmp_path, moved)
    (tmp_path / "calibration_campus.json").write_bytes((written / "calibration_campus.json").read_bytes())
    _, scores = run(tmp_path, f"--keypoints={written / 'keypoints'}")
    assert min(scores["mpjpe_mm"]) > 120.0


def test_keypoints_without_tested_images_are_refused(written: Path, simulation: Simulation, tmp_path: Path) -> None:
    names = {camera.name: f"Camera{number}" for number, camera in enumerate(simulation.cameras)}
    write_keypoints(tmp_path, simulation, names, first=20)
    (problem,) = problems_of(written, f"--keypoints={tmp_path}")
    assert problem["message"] == "The images are 20 to 79."
    assert "from 13 to 59" in problem["hint"]


def test_all_that_is_missing_is_reported_at_once(tmp_path: Path) -> None:
    for name in ("campus", "shelf"):
        files = [problem["file"] for problem in problems_of(tmp_path, name=name)]
        assert files == ["actorsGT.mat", f"calibration_{name}.json", "Camera0"]


def test_pictures_begin_with_one_image(written: Path, tmp_path: Path) -> None:
    for name in ("actorsGT.mat", "calibration_campus.json"):
        (tmp_path / name).write_bytes((written / name).read_bytes())
    for camera in range(3):
        path = tmp_path / f"Camera{camera}" / f"campus4-c{camera}-00013.png"
        path.parent.mkdir()
        path.touch()
    sequence = actors.load_actors(tmp_path, "campus")
    assert ([path.name for path in sequence.footage], sequence.first_image) == (["Camera0", "Camera1", "Camera2"], 13)
    path.rename(path.with_name("campus4-c2-00014.png"))
    with pytest.raises(InputError, match="Camera1 with 13, Camera2 with 14"):
        actors.load_actors(tmp_path, "campus")


def test_options_of_keypoint_files_are_refused_with_folders(written: Path) -> None:
    (problem,) = problems_of(written, f"--keypoints={written / 'keypoints'}", "--live", "--every=2", name="shelf")
    assert problem["message"].startswith("--every, --live need the keypoints of all images in one file")


def test_takes_without_people_have_no_error(simulation: Simulation) -> None:
    truth_m = benchmark_joints(simulation.truth_m)
    scores = actors.score_actors([], COCO_17, np.arange(truth_m.shape[1]), truth_m)
    assert scores["mpjpe_mm"] == [None, None, None]
    assert (scores["pcp"]["average"], scores["pck150"]) == (0.0, [0.0, 0.0, 0.0])


def element(kind: int, content: bytes) -> bytes:
    """Element of a MATLAB file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def cell(rows: int, content: bytes, name: bytes = b"") -> bytes:
    """Array of cells that states a number of rows."""
    head = element(6, struct.pack("<II", 1, 0)) + element(5, struct.pack("<ii", rows, 1)) + element(1, name)
    return element(14, head + content)


def mat(content: bytes) -> bytes:
    """MATLAB file of version 5."""
    return b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM" + content


def nested(depth: int) -> bytes:
    """Cells in cells, from the outermost one to the innermost one."""
    inner = len(cell(1, b""))
    heads = [struct.pack("<II", 14, inner * (depth - level) - 8) + cell(1, b"")[8:] for level in range(depth)]
    return cell(1, b"".join(heads), b"actor3D")


DAMAGED: list[tuple[str, Callable[[list[list[Any]]], Any], str]] = [
    ("text", lambda _: b"no file of MATLAB", "damaged, or in another format"),
    ("empty", lambda _: b"", "damaged, or in another format"),
    ("other variable", lambda _: mat(cell(0, b"", b"other")), "damaged, or in another format"),
    ("no cells", lambda _: mat(cell(0, b"", b"actor3D")), "actor3D has no poses"),
    ("huge", lambda _: mat(cell(2**31 - 1, b"", b"actor3D")), "damaged"),
    ("deep", lambda _: mat(nested(200_000)), "damaged"),
    (
        "shape",
        lambda cells: [[np.ones((13, 3)), *actor] for actor in cells],
        "actor 1 in image 0 is not a matrix of 14",
    ),
    ("far", lambda cells: [[np.full((14, 3), 2e3), *actor] for actor in cells], "a position is kilometres away"),
    ("few actors", lambda cells: cells[:2], "the shape is (2, 70, 14, 3)"),
    ("short", lambda cells: [actor[:50] for actor in cells], "the shape is (3, 50, 14, 3)"),
    ("unannotated", lambda cells: [*cells[:2], [0.0] * 70], "an actor is not annotated in any tested image"),
]


@pytest.mark.parametrize(("make", "reason"), [each[1:] for each in DAMAGED], ids=[each[0] for each in DAMAGED])
def test_damaged_truth_is_reported(
    simulation: Simulation, written: Path, tmp_path: Path, make: Callable[[list[list[Any]]], Any], reason: str
) -> None:
    (tmp_path / "calibration_campus.json").write_bytes((written / "calibration_campus.json").read_bytes())
    content = make(cells_of(simulation))
    if isinstance(content, bytes):
        (tmp_path / "actorsGT.mat").write_bytes(content)
    else:
        write_truth(tmp_path, content)
    (problem,) = problems_of(tmp_path, f"--keypoints={written / 'keypoints'}")
    assert problem["file"] == "actorsGT.mat"
    assert problem["message"].startswith("The truth can't be read: ")
    assert reason in problem["message"]


def test_bombs_and_pipes_are_refused(written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "calibration_campus.json").write_bytes((written / "calibration_campus.json").read_bytes())
    path = write_truth(tmp_path, [[np.zeros((400, 400, 400))]])
    assert path.stat().st_size < 2**20
    monkeypatch.setattr("pipeline.validation.evaluation.datasets.read_truth._LIMITS", (60, 3 * 2**28, 2**20, 64))
    (problem,) = problems_of(tmp_path, f"--keypoints={written / 'keypoints'}")
    assert "memory" in problem["message"]
    path.unlink()
    os.mkfifo(path)
    (problem,) = problems_of(tmp_path, f"--keypoints={written / 'keypoints'}")
    assert problem["message"] == "The truth can't be read: no file that can be opened."
