"""Keypoint folders: accepted and rejected input, and messages of the problems."""

import json
import shutil
from pathlib import Path
from shutil import copy

import numpy as np
import pytest

from pipeline.capture.keypoint_files.people import MAX_PEOPLE
from pipeline.capture.keypoints import open_keypoints
from pipeline.capture.preflight_record import Recording
from pipeline.core.errors import InputError
from pipeline.core.joints import BODY_25, COCO_17, COCO_18
from pipeline.validation.simulation.scenes import Simulation
from tests.pipeline.capture.keypoint_scenes import edit, frame_with_people, messages, opened, problems_of, split_frames
from tests.records import encode_record


def test_simulated_truth_comes_back(scene: Path, simulation: Simulation) -> None:
    session = opened(scene)
    assert session.joints == COCO_17
    assert session.findings == ()
    assert session.timebase.start_time_s == 0.0
    for camera in simulation.cameras:
        ours, theirs = simulation.detections[camera.name], session.detections[camera.name]
        np.testing.assert_array_equal(session.times[camera.name].time_s, simulation.times[camera.name].time_s)
        np.testing.assert_array_equal(theirs.frame, ours.frame)
        np.testing.assert_array_equal(theirs.keypoints_px, ours.keypoints_px)
        np.testing.assert_array_equal(theirs.score, ours.score)


def test_paths_may_be_texts(scene: Path) -> None:
    folder, calibration, timestamps = map(
        str, (scene / "keypoints", scene / "calibration.json", scene / "timestamps.csv")
    )
    session = open_keypoints(folder, calibration, timestamps)
    assert encode_record(session) == encode_record(opened(scene))


def test_without_timestamps_frame_k_is_file_k(scene: Path) -> None:
    first, *_, last = split_frames(scene)
    first.unlink()
    session = opened(scene, timed=False, frame_rate_hz=25.0)
    camera = first.parent.name
    assert session.times[camera].time_s[0] == 1 / 25
    assert session.timebase.start_time_s == 0.0
    assert session.timebase.num_frames >= int(last.name[6:18]) + 1
    faster = opened(scene, timed=False, frame_rate_hz=50.0)
    assert faster.times[camera].time_s[0] == 1 / 50
    assert faster.timebase.frame_rate_hz == 50.0


def test_no_rate_is_assumed(scene: Path) -> None:
    (problem,) = problems_of(scene, timed=False).items()
    assert problem[0] == "no_frame_rate"
    assert "--frame-rate" in problem[1]


@pytest.mark.parametrize("joints", [BODY_25, COCO_18], ids=["BODY_25", "COCO-18"])
def test_other_joint_sets_are_told_by_their_length(scene: Path, simulation: Simulation, joints: object) -> None:
    names = joints.names  # type: ignore[attr-defined]

    def spread(people: list[list[float]]) -> None:
        for row, one in enumerate(people):
            xys = np.array(one).reshape(17, 3)
            other = np.zeros((len(names), 3))
            for k, name in enumerate(names):
                if name in COCO_17.names:
                    other[k] = xys[COCO_17.index(name)]
            people[row] = other.ravel().tolist()

    for camera in range(3):
        for path in split_frames(scene, camera):
            edit(path, spread)
    session = opened(scene)
    assert session.joints == joints
    camera_name = simulation.cameras[0].name
    wrist = session.joints.index("left_wrist")
    np.testing.assert_array_equal(
        session.detections[camera_name].keypoints_px[:, wrist],
        simulation.detections[camera_name].keypoints_px[:, COCO_17.index("left_wrist")],
    )
    assert np.isnan(session.detections[camera_name].keypoints_px[:, session.joints.index("neck")]).all()


def test_joints_that_are_no_numbers_or_have_no_score_are_unseen(scene: Path, simulation: Simulation) -> None:
    path = frame_with_people(scene, simulation)

    def spoil(people: list[list[float]]) -> None:
        people[0][:12] = [5.0, 6.0, -0.5, float("nan"), 6.0, 0.5, 7.0, 8.0, 0.0, 9.0, 10.0, 7.5]

    edit(path, spoil)
    found = opened(scene).detections[path.parent.name]
    assert np.isnan(found.keypoints_px[0, :3]).all()
    np.testing.assert_array_equal(found.score[0, :4], [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(found.keypoints_px[0, 3], [9.0, 10.0])
    assert np.isfinite(found.box_px[0]).all()


def test_camera_that_saw_nobody_is_said(scene: Path) -> None:
    for path in split_frames(scene):
        path.write_text('{"people": []}')
    session = opened(scene)
    camera = split_frames(scene)[0].parent.name
    assert messages(session) == [f"Camera {camera} saw no people."]
    assert len(session.detections[camera].frame) == 0


def test_other_files_are_ignored_and_said(scene: Path) -> None:
    (split_frames(scene)[0].parent / "notes.txt").write_text("hello")
    (scene / "keypoints" / "readme.md").write_text("hello")
    warnings = messages(opened(scene))
    assert any("notes.txt" in warning for warning in warnings)
    assert any("readme.md" in warning for warning in warnings)


@pytest.mark.parametrize(
    "content",
    [
        "",
        '{"people": [',
        "[3]",
        '{"people": 3}',
        '{"people": [{"person_id": [-1]}]}',
        '{"people": [{"pose_keypoints_2d": [1, 2]}]}',
    ],
)
def test_damaged_file_is_named(scene: Path, content: str) -> None:
    path = split_frames(scene)[2]
    path.write_text(content)
    assert path.name in problems_of(scene)["keypoints_unreadable"]


def test_many_damaged_files_are_not_all_listed(scene: Path) -> None:
    for path in split_frames(scene):
        path.write_text("{")
    with pytest.raises(InputError) as raised:
        opened(scene)
    assert len(raised.value.problems) == 11
    assert "more files have problems" in str(raised.value.problems[-1])


def test_two_kinds_of_files_are_refused(scene: Path) -> None:
    def lengthen(people: list[list[float]]) -> None:
        for one in people:
            one.extend([0.0] * 24)

    for path in split_frames(scene):
        edit(path, lengthen)
    assert "25 joints" in problems_of(scene)["keypoints_mixed"]


def test_folders_that_match_no_camera(scene: Path) -> None:
    folder = split_frames(scene)[0].parent
    folder.rename(folder.with_name("elsewhere"))
    problems = problems_of(scene)
    assert "elsewhere" in problems["folder_without_camera"]
    assert folder.name in problems["camera_without_folder"]


def test_folders_of_other_names_are_paired_in_order(scene: Path, simulation: Simulation) -> None:
    for k, folder in enumerate(sorted((scene / "keypoints").iterdir())):
        folder.rename(folder.with_name(f"view{k}"))
    assert "pairing_unknown" in problems_of(scene)
    session = open_keypoints(scene / "keypoints", scene / "calibration.json", frame_rate_hz=25.0, pair_by_order=True)
    assert any("by the order of their names" in warning for warning in messages(session))
    assert set(session.detections) == {camera.name for camera in simulation.cameras}


def test_files_that_macos_adds_are_passed_over_and_named_once(scene: Path) -> None:
    path = split_frames(scene)[0]
    (scene / "keypoints" / "__MACOSX").mkdir()
    for name in (f"._{path.name}", f"._{path.stem}_2.json"):
        (path.parent / name).write_bytes(b"\0\5\x16\7")
    session = opened(scene)
    (finding,) = session.findings
    assert (finding.code, finding.evidence) == ("file_ignored", {"num_files": 3})
    assert finding.message.endswith(f": ._{path.name}, ._{path.stem}_2.json, __MACOSX.")


def test_cameras_without_folder_are_left_out(scene: Path) -> None:
    rig = json.loads((scene / "calibration.json").read_text())
    rig["cameras"].insert(0, rig["cameras"][0] | {"name": "ceiling"})
    (scene / "calibration.json").write_text(json.dumps(rig))
    session = opened(scene, timed=False, frame_rate_hz=25.0)
    assert "ceiling" not in {camera.name for camera in session.cameras}
    assert len(session.cameras) == len(session.detections) == len(rig["cameras"]) - 1
    assert any("ceiling" in warning for warning in messages(session))


def test_calibration_without_sizes_is_refused(scene: Path) -> None:
    lens = {"fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0, "k": [0.0] * 3, "p": [0.0] * 2}
    names = [camera["name"] for camera in json.loads((scene / "calibration.json").read_text())["cameras"]]
    cameras = {name: {"R": np.eye(3).tolist(), "T": [0.0, 0.0, float(k)], **lens} for k, name in enumerate(names)}
    (scene / "calibration.json").write_text(json.dumps(cameras))
    problem = problems_of(scene)["invalid_size"]
    assert "does not contain the size" in problem
    assert "--size 1920x1080" in problem


def test_missing_folders(tmp_path: Path, scene: Path) -> None:
    with pytest.raises(InputError, match="The folder does not exist"):
        open_keypoints(tmp_path / "nowhere", scene / "calibration.json")


def test_all_is_said_at_once(scene: Path) -> None:
    (scene / "calibration.json").write_text("{")
    split_frames(scene)[0].write_text("{")
    (scene / "timestamps.csv").write_text("camera,frame\n")
    assert {"keypoints_unreadable"} < problems_of(scene).keys()


def with_people(path: Path, num_people: int, person: list[float]) -> None:
    path.write_text(json.dumps({"people": [{"pose_keypoints_2d": person}] * num_people}))


def test_people_without_joint_are_left_out(scene: Path, simulation: Simulation) -> None:
    before = opened(scene)
    for path in (scene / "keypoints").rglob("*.json"):
        edit(path, lambda people: people.extend([[0.0] * 51] * 200))
    after = opened(scene)
    for camera in simulation.cameras:
        np.testing.assert_array_equal(
            after.detections[camera.name].keypoints_px, before.detections[camera.name].keypoints_px
        )


def test_session_of_people_without_joints_shows_nobody(scene: Path) -> None:
    for path in (scene / "keypoints").rglob("*.json"):
        with_people(path, 3, [0.0] * 51)
    assert [warning for warning in messages(opened(scene)) if "saw no people" in warning]


def test_too_many_people_are_named_with_camera_and_frame(scene: Path) -> None:
    first, other = split_frames(scene)[3], split_frames(scene, 1)[5]
    with_people(first, MAX_PEOPLE + 1, [100.0, 100.0, 0.5] * 17)
    with_people(other, 5000, [0.0] * 51)
    with pytest.raises(InputError) as raised:
        opened(scene)
    problems = {problem.camera: problem for problem in raised.value.problems}
    assert {problem.code for problem in problems.values()} == {"too_many_people"}
    assert problems[first.parent.name].message == "Frame 3 has 129 people; at most 128 are allowed."
    assert problems[other.parent.name].message.startswith("Frame 5 has 5000 people")
    with_people(first, MAX_PEOPLE, [100.0, 100.0, 0.5] * 17)
    other.unlink()
    assert max(np.bincount(opened(scene).detections[first.parent.name].frame)) == MAX_PEOPLE


def test_more_joints_than_session_may_hold_are_not_read(scene: Path, simulation: Simulation) -> None:
    files = scene / "keypoints", scene / "calibration.json", scene / "timestamps.csv"
    num_joints = sum(one.score.size for one in simulation.detections.values())
    assert open_keypoints(*files, max_joints=num_joints)
    with pytest.raises(InputError, match="more than") as raised:
        open_keypoints(*files, max_joints=num_joints - 1)
    assert "session_too_large" in {problem.code for problem in raised.value.problems}


def stated(scene: Path, simulation: Simulation) -> dict[str, Path]:
    """Folders of the cameras, moved to places whose names tell of no camera."""
    places = {}
    for number, camera in enumerate(simulation.cameras):
        places[camera.name] = scene / f"take {number}" / "json"
        places[camera.name].parent.mkdir()
        (scene / "keypoints" / camera.name).rename(places[camera.name])
    return places


def test_stated_folders_are_those_of_their_cameras(scene: Path, simulation: Simulation) -> None:
    rest = scene / "calibration.json", scene / "timestamps.csv"
    by_name = open_keypoints(scene / "keypoints", *rest)
    session = open_keypoints(stated(scene, simulation), *rest)
    assert [camera.name for camera in session.cameras] == [camera.name for camera in by_name.cameras]
    for name, detections in by_name.detections.items():
        np.testing.assert_array_equal(session.detections[name].keypoints_px, detections.keypoints_px)
    assert session.findings == ()


def test_recordings_name_folders_and_others_are_paired_by_name(scene: Path, simulation: Simulation) -> None:
    rest = scene / "calibration.json", scene / "timestamps.csv"
    by_name = open_keypoints(scene / "keypoints", *rest)
    first, second, *_ = [camera.name for camera in simulation.cameras]
    exchanged = {first: scene / "keypoints" / "take", second: scene / "keypoints" / first}
    for camera, folder in exchanged.items():
        (scene / "keypoints" / camera).rename(folder)
    session = open_keypoints(
        scene / "keypoints", *rest, recordings=[Recording(camera, path.name) for camera, path in exchanged.items()]
    )
    assert session.folders == {**by_name.folders, first: "take", second: first}
    for name, detections in by_name.detections.items():
        np.testing.assert_array_equal(session.detections[name].keypoints_px, detections.keypoints_px)


def test_camera_of_recording_is_not_left_out(scene: Path, simulation: Simulation) -> None:
    first, *_ = [camera.name for camera in simulation.cameras]
    shutil.rmtree(scene / "keypoints" / first)
    rest = scene / "calibration.json", scene / "timestamps.csv"
    with pytest.raises(InputError) as refused:
        open_keypoints(scene / "keypoints", *rest, recordings=[Recording(first)])
    assert [(problem.code, problem.camera) for problem in refused.value.problems] == [("camera_without_folder", first)]


def test_all_that_is_wrong_with_stated_folders_is_named(scene: Path, simulation: Simulation) -> None:
    first, second, third, *_ = [camera.name for camera in simulation.cameras]
    folder = scene / "keypoints" / first
    wrong = {first: folder, second: folder, third: scene / "missing", "cam_x": scene / "keypoints" / second}
    with pytest.raises(InputError) as refused:
        open_keypoints(wrong, scene / "calibration.json", frame_rate_hz=25.0)
    assert [(problem.code, problem.camera) for problem in refused.value.problems][:4] == [
        ("keypoints_missing", third),
        ("recording_camera_unknown", "cam_x"),
        ("duplicate_keypoints", first),
        ("duplicate_keypoints", second),
    ]


def test_open_keypoints_uses_files_beside_folders(scene: Path) -> None:
    for name in ("timestamps.csv", "calibration.json"):
        (scene / name).rename(scene / "keypoints" / name)
    (scene / "keypoints" / "other.csv").write_text("")
    folder = scene / "keypoints"
    session = open_keypoints(folder, folder / "calibration.json", folder / "timestamps.csv")
    assert messages(session) == ["other.csv is ignored: it is not a folder."]
    copied = open_keypoints(folder, folder / "calibration.json", copy(folder / "timestamps.csv", scene))
    assert copied.findings == session.findings
    unread = open_keypoints(folder, folder / "calibration.json", frame_rate_hz=25.0)
    assert any("timestamps.csv are not used: state the file" in warning for warning in messages(unread))
