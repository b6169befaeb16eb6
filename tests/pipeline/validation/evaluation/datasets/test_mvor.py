"""MVOR: annotations, cameras and keypoints in its form, scores of known poses, and files that can't be used."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.geometry.camera import project
from pipeline.validation.evaluation.average_precision import InstantPoses
from pipeline.validation.evaluation.datasets.mvor import (
    JOINTS,
    MvorBenchmark,
    at_instants,
    load_days,
    load_mvor,
    read_keypoints,
)
from pipeline.validation.evaluation.datasets.mvor_scores import score_joints_2d, score_mvor
from pipeline.validation.simulation.scenes import Simulation
from tests.cases import slow_but
from tests.pipeline.validation.evaluation.datasets.mvor_files import (
    ONLY_BOX,
    annotated_m,
    image_id,
    mvor_document,
    mvor_keypoints,
    simulate_room,
    write_json,
    write_mvor,
)

FRAMES = range(10, 200, 30)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_room()


@pytest.fixture
def document(simulation: Simulation) -> dict[str, Any]:
    return mvor_document(simulation, FRAMES)


@pytest.fixture
def folder(document: dict[str, Any], tmp_path: Path) -> Path:
    return write_mvor(tmp_path, document)


def keypoints_of(simulation: Simulation, document: dict[str, Any], folder: Path) -> Path:
    return write_json(folder / "keypoints.json", mvor_keypoints(simulation, document, FRAMES))


def true_poses(simulation: Simulation, shift_m: float = 0.0) -> list[InstantPoses]:
    """True poses of all people, shifted along the world's x."""
    xyz_m = annotated_m(simulation, FRAMES)[:, :, 2:] + [shift_m, 0.0, 0.0]
    return [InstantPoses(xyz_m[:, column], np.ones(len(xyz_m))) for column in range(len(FRAMES))]


def problems_of(folder: Path, keypoints: Path | None = None) -> list[dict[str, Any]]:
    options = [] if keypoints is None else [f"--detections={keypoints}"]
    result = CliRunner().invoke(app, ["evaluate", "mvor", f"--data={folder}", "--json", *options])
    assert result.exit_code == 2, result.output
    problems: list[dict[str, Any]] = json.loads(result.stdout)["problems"]
    return problems


def test_annotations_are_read_in_world_of_room(simulation: Simulation, folder: Path) -> None:
    benchmark = load_mvor(folder)
    assert len(benchmark.instants) == len(FRAMES)
    truth_m = annotated_m(simulation, FRAMES)
    for column, instant in enumerate(benchmark.instants):
        np.testing.assert_allclose(instant.truth_m, truth_m[:ONLY_BOX, column], atol=1e-9)
        for camera, picture in zip(benchmark.cameras, instant.pictures, strict=True):
            assert len(picture.box_px) == 3
            assert len(picture.joints_px) == 2
            np.testing.assert_allclose(project(camera, instant.truth_m), picture.joints_px, atol=1e-6)


def test_joints_without_place_are_unknown(document: dict[str, Any], tmp_path: Path) -> None:
    document["annotations3D"][0]["keypoints3D"][4 * 8 + 2] = 0.0
    document["annotations"][0]["keypoints"][3 * 8 : 3 * 8 + 3] = [0.0, 0.0, 0]
    instant = load_mvor(write_mvor(tmp_path, document)).instants[0]
    assert np.isnan(instant.truth_m).any(-1).nonzero() == (0, 8)
    assert np.isnan(instant.pictures[0].joints_px).any(-1).nonzero() == (0, 8)


def test_scores_of_true_poses(simulation: Simulation, document: dict[str, Any], folder: Path) -> None:
    benchmark = load_mvor(folder)
    detections, _ = read_keypoints(keypoints_of(simulation, document, folder), benchmark)
    scores = score_mvor(true_poses(simulation), benchmark, detections)
    assert (scores["instants"], scores["people"]) == (len(FRAMES), 2 * len(FRAMES))
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-6)
    assert (scores["recall"], scores["pck150"], scores["recall_500"]) == (1.0, 1.0, 1.0)
    # The person who has boxes alone is nobody false.
    assert scores["false_people"] == 0.0
    assert scores["mpjpe_by_joint_mm"]["wrist"] == pytest.approx(0.0, abs=1e-6)
    assert sum(row["people"] for row in scores["by_cameras"].values()) == scores["people"]


def test_scores_of_shifted_poses(simulation: Simulation, document: dict[str, Any], folder: Path) -> None:
    benchmark = load_mvor(folder)
    detections, _ = read_keypoints(keypoints_of(simulation, document, folder), benchmark)
    poses = true_poses(simulation, 0.06)
    for each in poses:
        each.xyz_m[0, 6:] += [0.0, 0.0, 0.08]  # wrists: 100 mm
    scores = score_mvor(poses, benchmark, detections)
    assert scores["mpjpe_by_joint_mm"] == pytest.approx(
        {"shoulder": 60.0, "hip": 60.0, "elbow": 60.0, "wrist": 80.0, "average": 65.0}
    )
    assert scores["ap"][50] == 0.0
    assert scores["ap"][75] > 0.6


def test_false_people_are_in_no_box(simulation: Simulation, document: dict[str, Any], folder: Path) -> None:
    benchmark = load_mvor(folder)
    detections, _ = read_keypoints(keypoints_of(simulation, document, folder), benchmark)
    poses = [
        InstantPoses(np.concatenate([each.xyz_m, each.xyz_m[:1] + np.array([0.0, 0.0, 4.0])]), np.ones(4))
        for each in true_poses(simulation)
    ]
    assert score_mvor(poses, benchmark, detections)["false_people"] == pytest.approx(0.25)


def test_people_are_told_by_number_of_their_cameras(
    simulation: Simulation, document: dict[str, Any], folder: Path
) -> None:
    benchmark = load_mvor(folder)
    everybody = _exact(benchmark)
    detections = everybody | {"cam2": _without(everybody["cam2"])}
    scores = score_mvor(true_poses(simulation), benchmark, detections)
    people = {count: row["people"] for count, row in scores["by_cameras"].items()}
    assert people == {0: 0, 1: 0, 2: 2 * len(FRAMES), 3: 0}


def test_joints_in_2d(document: dict[str, Any], tmp_path: Path) -> None:
    benchmark = load_mvor(write_mvor(tmp_path, of_one_person(document)))
    bodies = _exact(benchmark)
    scores = {name: np.ones(len(detections.frame)) for name, detections in bodies.items()}
    assert set(score_joints_2d(bodies, scores, benchmark).values()) == {1.0}
    for detections in bodies.values():
        detections.keypoints_px[:, COCO_17.index("left_wrist")] += 400.0
    known = score_joints_2d(bodies, scores, benchmark)
    assert known["wrist"] == pytest.approx(0.5)
    assert known["mean"] == pytest.approx(0.9)


def of_one_person(document: dict[str, Any]) -> dict[str, Any]:
    """Annotations of one person: of people behind each other, the data set's rule may take the other one."""
    return document | {"annotations": [person for person in document["annotations"] if person["person_id"] == 0]}


def test_joints_that_are_not_annotated_count_as_wrong(document: dict[str, Any], tmp_path: Path) -> None:
    document = of_one_person(document)
    for person in document["annotations"]:
        person["keypoints"][3 * 8 : 3 * 8 + 3] = [0.0, 0.0, 0]
    benchmark = load_mvor(write_mvor(tmp_path, document))
    bodies = _exact(benchmark)
    scores = {name: np.ones(len(detections.frame)) for name, detections in bodies.items()}
    assert score_joints_2d(bodies, scores, benchmark)["wrist"] == pytest.approx(0.5)


def _exact(benchmark: MvorBenchmark) -> dict[str, Detections]:
    """Detections at the annotated joints in 2D; ears are where the head is."""
    names = ("left_ear", *JOINTS[2:])
    bodies = {}
    for place, camera in enumerate(benchmark.cameras):
        listed = [
            (number, joints_px)
            for number, instant in enumerate(benchmark.instants)
            for joints_px in instant.pictures[place].joints_px
        ]
        points_px = np.full((len(listed), 17, 2), np.nan)
        for row, (_, joints_px) in enumerate(listed):
            points_px[row, COCO_17.indices(names)] = joints_px[[0, *range(2, 10)]]
        frames = np.array([number for number, _ in listed])
        score = np.isfinite(points_px).all(-1).astype(float)
        bodies[camera.name] = Detections(camera.name, frames, points_px, score, np.zeros((len(listed), 4)))
    return bodies


def _without(detections: Detections) -> Detections:
    return detections.within(range(0))


@pytest.mark.parametrize("method", slow_but(["tracking"], ["tracking", "clustering"]))
def test_keypoints_are_reconstructed_and_scored(
    simulation: Simulation, document: dict[str, Any], folder: Path, method: str
) -> None:
    keypoints = keypoints_of(simulation, document, folder)
    command = ["evaluate", "mvor", f"--data={folder}", f"--detections={keypoints}", f"--method={method}"]
    result = CliRunner().invoke(app, [*command, "--json"])
    assert result.exit_code == 0, result.output
    scores = json.loads(result.stdout)
    assert scores["recall"] == 1.0
    assert scores["mpjpe_mm"] < 60.0
    assert scores["false_people"] == 0.0
    assert scores["pck_2d"]["mean"] > 0.8
    table = CliRunner().invoke(app, command)
    assert table.exit_code == 0, table.exception
    assert "mpjpe_by_joint_mm shoulder" in table.output
    assert "number of cameras" in table.output


def test_missing_file_and_missing_pictures_are_named(document: dict[str, Any], tmp_path: Path) -> None:
    (problem,) = problems_of(tmp_path)
    assert (problem["code"], problem["file"]) == ("dataset_incomplete", "camma_mvor_2018.json")
    write_mvor(tmp_path, document)
    days = problems_of(tmp_path)
    assert [problem["code"] for problem in days] == ["dataset_incomplete"] * 2
    assert "9 of 9 pictures of day1 are missing, such as day1/cam1/color/000000.png" in days[0]["message"]
    assert "--detections" in days[0]["hint"]


def test_pictures_are_found_by_day(folder: Path) -> None:
    benchmark = load_mvor(folder)
    for instant in benchmark.instants:
        for picture in instant.pictures:
            path = folder / "camma_mvor_dataset" / picture.file_name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    _, second = load_days(folder, benchmark)
    assert [path.relative_to(folder).as_posix() for path in second.folders] == [
        f"camma_mvor_dataset/day2/cam{number}/color" for number in (1, 2, 3)
    ]
    assert (second.instants.tolist(), second.frames.tolist()) == ([3, 4, 5, 6], [0, 1, 2, 3])
    points_px = np.zeros((3, 17, 2))
    seen = Detections("cam1", np.array([0, 3, 7]), points_px, np.ones((3, 17)), np.zeros((3, 4)))
    assert at_instants(seen, COCO_17, second).frame.tolist() == [3, 6]
    (second.folders[1] / "000000.png").rename(second.folders[1] / "000009.png")
    with pytest.raises(InputError, match="1 of 12 pictures of day2 are missing"):
        load_days(folder, benchmark)


@pytest.mark.parametrize(
    ("change", "fields"),
    [
        (lambda document: document["annotations"][3].update(bbox=[1, 2, 3]), ["annotations[3]"]),
        (lambda document: document["annotations"][3].update(bbox=[1, 2, 3, float("inf")]), ["annotations[3]"]),
        (lambda document: document["annotations"][3].pop("image_id"), ["annotations[3]"]),
        (lambda document: document["annotations"].append("nobody"), ["annotations[63]"]),
        (lambda document: document["annotations3D"][2].update(keypoints3D=[1.0] * 47), ["annotations3D[2]"]),
        (lambda document: document["annotations3D"][2].update(image_ids="elsewhere"), ["annotations3D"]),
        (lambda document: document["multiview_images"][1]["images"].pop(), ["multiview_images[1]"]),
        (
            lambda document: document["multiview_images"][1]["images"][0].update(file_name="../../etc/000001.png"),
            ["multiview_images[1]"],
        ),
        (
            lambda document: document["multiview_images"][1]["images"][0].update(
                file_name="day2/cam1/color/000001.png"
            ),
            ["multiview_images[1]"],
        ),
        (
            lambda document: (
                document["annotations"][3].update(bbox=None),
                document["annotations3D"][2].update(keypoints3D="?"),
                document["cameras_info"]["camParams"].update(firstCamToRoomRef=[1.0] * 16),
            ),
            ["firstCamToRoomRef", "annotations[3]", "annotations3D[2]"],
        ),
        (lambda document: document["cameras_info"].update(camParams={}), ["firstCamToRoomRef"]),
        (lambda document: document["annotations"][3].update(bbox=[1e308, 0.0, 1e308, 1.0]), ["annotations[3]"]),
        (lambda document: document["annotations"][3].update(keypoints=[1e200] * 30), ["annotations[3]"]),
        (lambda document: document["annotations"].extend([document["annotations"][3]] * 130), ["annotations"]),
        (lambda document: document["annotations3D"][2].update(keypoints3D=[1e200] * 48), ["annotations3D[2]"]),
        (lambda document: document["annotations3D"].extend([document["annotations3D"][2]] * 130), ["annotations3D"]),
        (
            lambda document: document["multiview_images"][1]["images"][0].update(
                file_name=f"day1/cam1/color/{'9' * 30}.png"
            ),
            ["multiview_images[1]"],
        ),
    ],
)
def test_fault_is_reported_at_its_place(
    document: dict[str, Any], tmp_path: Path, change: Callable[[dict[str, Any]], None], fields: list[str]
) -> None:
    change(document)
    problems = problems_of(write_mvor(tmp_path, document))
    assert set(fields) <= {problem.get("field") for problem in problems}
    assert all(problem["file"] == "camma_mvor_2018.json" for problem in problems)


def test_many_faults_are_counted(document: dict[str, Any], tmp_path: Path) -> None:
    for person in document["annotations"]:
        person["bbox"] = None
    document["annotations3D"][2]["keypoints3D"] = "?"
    problems = problems_of(write_mvor(tmp_path, document))
    assert len(problems) == 12
    assert problems[10]["message"] == "53 more entries can't be read."
    assert problems[11]["field"] == "annotations3D[2]"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "no valid JSON"),
        ("[" * 100_000, "no valid JSON"),
        ("[]", "lacks multiview_images, annotations, annotations3D, cameras_info"),
        ('{"annotations": [], "multiview_images": 3}', "lacks annotations, annotations3D, cameras_info"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "camma_mvor_2018.json").write_text(content, encoding="utf-8")
    (problem,) = problems_of(tmp_path)
    assert problem["code"] == "benchmark_unreadable"
    assert message in problem["message"]


def test_faults_of_keypoints(simulation: Simulation, document: dict[str, Any], folder: Path) -> None:
    people = mvor_keypoints(simulation, document, FRAMES)
    people[1]["image_id"] = image_id(9, 1, 0)
    people[2]["coco_keypoints"] = [0.0] * 50
    people[4]["score"] = "high"
    people[5] = {}
    problems = problems_of(folder, write_json(folder / "keypoints.json", people))
    assert [problem["field"] for problem in problems] == ["[1]", "[2]", "[4]", "[5]"]
    assert "is missing or unknown" in problems[0]["message"]
    assert "51 finite numbers" in problems[1]["message"]
    (problem,) = problems_of(folder, folder / "none.json")
    assert problem["message"] == "The file can't be read (no file that can be opened)."
    (problem,) = problems_of(folder, write_json(folder / "keypoints.json", {"people": []}))
    assert problem["message"] == "The file is not a list of people."


def test_keypoints_of_stranger(simulation: Simulation, document: dict[str, Any], folder: Path) -> None:
    people = mvor_keypoints(simulation, document, FRAMES)
    people[1]["coco_keypoints"][:3] = [1e200, -1e200, 0.9]
    people[2]["score"] = float("inf")
    people[3]["score"] = "nan"
    people += [people[5]] * 130
    problems = problems_of(folder, write_json(folder / "keypoints.json", people))
    assert [problem.get("field") for problem in problems] == ["[1]", "[2]", "[3]", None]
    assert "-1,000,000 to 1,000,000 pixels" in problems[0]["message"]
    assert "at most 128 are allowed" in problems[-1]["message"]


def test_pipes_and_devices_are_not_waited_for(document: dict[str, Any], folder: Path) -> None:
    os.mkfifo(folder / "pipe.json")
    (folder / "zeros.json").symlink_to("/dev/zero")
    for name in ("pipe.json", "zeros.json"):
        (problem,) = problems_of(folder, folder / name)
        assert problem["message"] == "The file can't be read (no file that can be opened)."


def test_too_many_instants_are_refused(document: dict[str, Any], tmp_path: Path) -> None:
    document["multiview_images"] = [{}] * 14_000
    (problem,) = problems_of(write_mvor(tmp_path, document))
    assert problem["message"] == "The file has 14,000 instants; at most 10,000 are allowed."
