"""CMU Panoptic: sequences in the form of its toolbox, scores, and folders that can't be used."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.cli.main import app
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source, Track3D
from pipeline.validation.evaluation.datasets.panoptic import CAMERAS, load_panoptic, score_panoptic
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.validation.evaluation.datasets.panoptic_files import write_poses, write_sequence

CHOSEN = CAMERAS[:4]


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=3.0), seed=3)


@pytest.fixture(scope="module")
def written(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sequence(tmp_path_factory.mktemp("panoptic") / "171204_pose1", simulation, CHOSEN)


def run(folder: Path, *options: str) -> tuple[int, dict[str, Any]]:
    command = ["evaluate", "panoptic", f"--data={folder}", f"--cameras={','.join(CHOSEN)}", "--json", *options]
    result = CliRunner().invoke(app, command)
    return result.exit_code, json.loads(result.stdout)


def problems_of(folder: Path, *options: str) -> list[dict[str, Any]]:
    code, answer = run(folder, *options)
    assert code == 2
    problems: list[dict[str, Any]] = answer["problems"]
    return problems


def true_tracks(simulation: Simulation, shift_m: float = 0.0) -> list[Track3D]:
    shape = simulation.truth_m.shape[1:3]
    return [
        Track3D(
            number + 1,
            0,
            xyz_m + np.array([shift_m, 0.0, 0.0]),
            np.ones(shape),
            np.full(shape, Source.MEASURED),
            np.ones(shape),
            np.full(shape, 4),
        )
        for number, xyz_m in enumerate(simulation.truth_m)
    ]


def calibrated(written: Path, tmp_path: Path) -> Path:
    """Folder of a sequence with nothing but a calibration."""
    folder = tmp_path / written.name
    folder.mkdir()
    name = f"calibration_{written.name}.json"
    (folder / name).write_bytes((written / name).read_bytes())
    return folder


def bodies_of(folder: Path, frame: int) -> list[dict[str, Any]]:
    path = folder / "hdPose3d_stage1_coco19" / f"body3DScene_{frame:08}.json"
    bodies: list[dict[str, Any]] = json.loads(path.read_bytes())["bodies"]
    return bodies


def times_of(simulation: Simulation) -> dict[int, float]:
    return {frame: simulation.timebase.time_s(frame) for frame in range(simulation.timebase.num_frames)}


def test_true_tracks_have_no_error(simulation: Simulation, written: Path) -> None:
    sequence = load_panoptic(written, CHOSEN, has_footage=False)
    assert sequence.frames.tolist() == list(range(0, simulation.timebase.num_frames, 12))
    scored = (true_tracks(simulation), simulation.joints, simulation.timebase, sequence, times_of(simulation))
    scores = score_panoptic(*scored)
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-2)
    assert scores["mpjpe_500_mm"] == pytest.approx(0.0, abs=1e-2)
    assert (scores["mean_ap"], scores["recall_500"], scores["switches"]) == (1.0, 1.0, 0)
    assert (scores["instants"], scores["people"]) == (len(sequence.frames), 3 * len(sequence.frames))


def test_shifted_tracks(simulation: Simulation, written: Path) -> None:
    sequence = load_panoptic(written, CHOSEN, every=10, has_footage=False)
    tracks = true_tracks(simulation, 0.06)
    scores = score_panoptic(tracks, simulation.joints, simulation.timebase, sequence, times_of(simulation))
    assert (scores["ap"][50], scores["ap"][75]) == (0.0, 1.0)
    assert scores["mpjpe_mm"] == pytest.approx(60.0, abs=1e-2)


def test_frames_outside_of_tracks_do_not_count(simulation: Simulation, written: Path) -> None:
    sequence = load_panoptic(written, CHOSEN, every=10, has_footage=False)
    rate_hz = simulation.timebase.frame_rate_hz
    cut = Timebase(simulation.timebase.time_s(20), rate_hz, 15)
    tracks = [replace(track.part(slice(20, 35)), start_frame=0) for track in true_tracks(simulation)]
    scores = score_panoptic(tracks, simulation.joints, cut, sequence, times_of(simulation))
    assert (scores["instants"], scores["recall"]) == (2, 1.0)
    assert scores["mpjpe_mm"] == pytest.approx(0.0, abs=1e-2)


def test_unknown_joints_and_people(simulation: Simulation, written: Path, tmp_path: Path) -> None:
    folder = calibrated(written, tmp_path)
    bodies = bodies_of(written, 0)
    bodies[0]["joints19"][4 * 5 + 3] = 0.1  # the left wrist
    bodies[1]["joints19"][4 * 2 + 3] = -1.0  # the centre of the hips
    write_poses(folder, 0, bodies)
    write_poses(folder, 12, [])
    sequence = load_panoptic(folder, CHOSEN, every=1, has_footage=False)
    assert sequence.frames.tolist() == [0]
    assert sequence.people == ((0, 2),)
    assert np.isnan(sequence.truth_m[0]).any(-1).nonzero() == (0, 5)
    np.testing.assert_allclose(
        sequence.truth_m[0][1, 1], simulation.truth_m[2, 0, simulation.joints.index("nose")], atol=1e-5
    )


def test_keypoints_are_reconstructed_and_scored(written: Path) -> None:
    code, scores = run(written, f"--keypoints={written / 'keypoints'}", "--every=5", "--frames=5:60")
    assert code == 0
    assert (scores["instants"], scores["recall"], scores["switches"]) == (11, 1.0, 0)
    assert scores["mpjpe_mm"] < 40.0
    assert scores["ap"]["150"] == 1.0


def test_keypoints_of_later_frames_keep_their_numbers(written: Path, tmp_path: Path) -> None:
    folder = tmp_path / "keypoints"
    for path in (written / "keypoints").glob("*/*_keypoints.json"):
        if int(path.name.split("_")[-2]) >= 25:
            (folder / path.parent.name).mkdir(parents=True, exist_ok=True)
            (folder / path.parent.name / path.name).write_bytes(path.read_bytes())
    code, scores = run(written, f"--keypoints={folder}", "--every=5")
    assert (code, scores["instants"], scores["recall"]) == (0, 10, 1.0)
    assert scores["mpjpe_mm"] < 40.0


def test_all_that_is_missing_is_said_at_once(written: Path, tmp_path: Path) -> None:
    folder = tmp_path / "171204_pose2"
    folder.mkdir()
    (folder / "hdVideos").mkdir()
    (folder / "hdVideos" / "hd_00_03.mp4").touch()
    (folder / "hdPose3d_stage1_coco19.tar").touch()
    problems = problems_of(folder)
    assert [problem["file"] for problem in problems] == [
        "calibration_*.json",
        "hd_00_06.mp4",
        "hd_00_12.mp4",
        "hd_00_13.mp4",
        "hdPose3d_stage1_coco19",
    ]
    assert problems[-1]["hint"] == "Unpack hdPose3d_stage1_coco19.tar in the folder."
    (problem,) = problems_of(written, f"--keypoints={written / 'keypoints'}", "--cameras=00_03,00_30")
    assert "has no camera 00_30" in problem["message"]
    (problem,) = problems_of(written, f"--keypoints={written / 'keypoints'}", "--cameras=00_03")
    assert "choice of cameras" in problem["message"]


def test_images_begin_with_one_frame(written: Path, tmp_path: Path) -> None:
    folder = calibrated(written, tmp_path)
    write_poses(
        folder, 12, json.loads((written / "hdPose3d_stage1_coco19" / "body3DScene_00000012.json").read_text())["bodies"]
    )
    for name in CHOSEN:
        path = folder / "hdImgs" / name / f"{name}_00000012.jpg"
        path.parent.mkdir(parents=True)
        path.touch()
    sequence = load_panoptic(folder, CHOSEN)
    assert (sequence.first_image, [path.name for path in sequence.footage]) == (12, list(CHOSEN))
    path.rename(path.with_name("00_13_00000013.jpg"))
    (problem,) = problems_of(folder)
    assert "00_12 with 12, 00_13 with 13" in problem["message"]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("[", "no valid JSON"),
        ("[]", "no list of bodies"),
        ('{"bodies": [3]}', "no list of bodies"),
        ('{"bodies": [{"id": 0, "joints15": []}]}', "joints15 of an older version"),
        ('{"bodies": [{"id": 0}]}', "a body has no joints19"),
        ('{"bodies": [{"id": 0, "joints19": [1.0, 2.0]}]}', "joints19 has 76 finite numbers"),
        ('{"bodies": [{"id": 0, "joints19": [' + "1e400," * 75 + "1]}]}", "joints19 has 76 finite numbers"),
        ('{"bodies": [{"id": 0, "joints19": [' + "1e9," * 75 + "1]}]}", "kilometres"),
        pytest.param('{"bodies": [' + '{"id": 0},' * 128 + '{"id": 0}]}', "129 people; at most 128", id="a crowd"),
        ('{"bodies": [{"id": "a", "joints19": [' + "1," * 75 + "1]}]}", "no number of its own"),
    ],
)
def test_poses_that_cannot_be_read_are_named(written: Path, tmp_path: Path, content: str, reason: str) -> None:
    folder = calibrated(written, tmp_path)
    for frame in range(12):
        write_poses(folder, frame, []).write_text(content, encoding="utf-8")
    problems = problems_of(folder, f"--keypoints={written / 'keypoints'}", "--every=1")
    assert len(problems) == 11
    assert reason in problems[0]["message"]
    assert problems[0]["file"] == "body3DScene_00000000.json"
    assert problems[10]["message"] == "2 more files of poses can't be read."


def test_pipes_and_devices_are_not_waited_for(written: Path, tmp_path: Path) -> None:
    folder = calibrated(written, tmp_path)
    pipe, device = write_poses(folder, 0, []), write_poses(folder, 1, [])
    pipe.unlink()
    os.mkfifo(pipe)
    device.unlink()
    device.symlink_to("/dev/zero")
    problems = problems_of(folder, f"--keypoints={written / 'keypoints'}", "--every=1")
    assert [problem["file"] for problem in problems] == [pipe.name, device.name]
    assert problems[0]["message"] == "The poses can't be read (no file that can be opened)."


def test_people_who_are_new_in_every_frame_are_refused(written: Path, tmp_path: Path) -> None:
    folder = calibrated(written, tmp_path)
    body = bodies_of(written, 0)[0]
    for frame in range(12):
        write_poses(folder, frame, [body | {"id": 100 * frame + number} for number in range(100)])
    (problem,) = problems_of(folder, f"--keypoints={written / 'keypoints'}", "--every=1")
    assert problem["message"] == "The poses number 1,200 people; at most 1,000 are allowed."
