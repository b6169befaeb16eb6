"""Keypoint files in the forms of other programs: what is read, and hostile variants."""

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoint_files import people
from pipeline.capture.keypoint_files.folders import Contents, read_folder
from pipeline.capture.keypoint_files.own_points import split_own
from pipeline.capture.keypoint_files.people import KeypointsError, find_joint_set
from pipeline.capture.keypoint_files.points import match_joint, named_layout
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.errors import Problem
from pipeline.core.joints import BODY_25, BODY_FEET, COCO_17, COCO_18, WHOLE_BODY
from pipeline.core.layouts import LAYOUTS
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.keypoint_programs import PROGRAMS, write_session

SIZE_PX = (640, 480)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)


@pytest.mark.parametrize("program", PROGRAMS)
def test_detections_come_back_from_files_of_program(tmp_path: Path, simulation: Simulation, program: str) -> None:
    name, _, special = program.partition(", ")
    write_session(simulation, program, tmp_path)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    (found,) = [one for one in session.findings if one.code == "keypoints_form"]
    assert found.evidence["forms"] == [name]
    assert found.severity == "info"
    taken = session.joints.indices(COCO_17.names)
    expected = {"EasyMocap": BODY_25, "MediaPipe": BODY_FEET, "COCO": BODY_FEET}.get(name, COCO_17)
    assert session.joints == (COCO_18 if special == "open" else expected)
    for camera in simulation.cameras:
        ours, theirs = simulation.detections[camera.name], session.detections[camera.name]
        seen = np.isfinite(ours.keypoints_px).any((1, 2))
        np.testing.assert_array_equal(theirs.frame, ours.frame[seen])
        np.testing.assert_allclose(theirs.keypoints_px[:, taken], ours.keypoints_px[seen], atol=1e-9)
        np.testing.assert_allclose(theirs.score[:, taken], np.clip(ours.score[seen], 0, 1), atol=1e-12)


def points(count: int) -> list[float]:
    """X, y and score of points: point k is at (10 k, 10 k + 1)."""
    return [value for k in range(count) for value in (10.0 * k, 10.0 * k + 1.0, 0.5)]


def read(folder: Path, content: Any, name: str = "take.json") -> tuple[Contents, list[Problem]]:
    folder = folder / "cam"
    folder.mkdir()
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    problems: list[Problem] = []
    return read_folder(folder, "left", SIZE_PX, 10**9, [], problems), problems


def positions(contents: Contents, frame: int, names: Sequence[str]) -> dict[str, float]:
    """X of the first person's joints."""
    people = contents.frames[frame]
    assert people.shape[1] == len(names)
    return {name: float(people[0, k, 0]) for k, name in enumerate(names)}


@pytest.mark.parametrize("layout", ["halpe-26", "halpe-136", "coco-wholebody-133"])
def test_points_of_alphapose_by_their_number(tmp_path: Path, layout: str) -> None:
    names = LAYOUTS[layout].points
    person = {"image_id": "frame_0031.png", "category_id": 1, "keypoints": points(len(names)), "idx": [1.0]}
    contents, problems = read(tmp_path, [person, person])
    assert not problems
    assert contents.forms == {"AlphaPose"}
    joints = LAYOUTS[layout].joints.names
    found = positions(contents, 31, joints)
    assert found == {name: 10.0 * names.index(name) for name in joints}
    assert len(contents.frames[31]) == 2


def test_people_that_poseflow_tracked(tmp_path: Path) -> None:
    names = LAYOUTS["halpe-26"].points
    person = {"keypoints": points(26), "scores": 2.7, "idx": 3}
    contents, problems = read(tmp_path, {"walk_12.jpg": [], "walk_13.jpg": [person, person | {"idx": 1}]})
    assert not problems
    assert contents.forms == {"AlphaPose"}
    assert positions(contents, 13, BODY_FEET.names)["left_heel"] == 10.0 * names.index("left_heel")
    assert {number: len(people) for number, people in contents.frames.items()} == {12: 0, 13: 2}


def pose2sim(count: int) -> dict[str, Any]:
    """Person as Pose2Sim writes the points of RTMPose."""
    empty = [f"{part}_keypoints_{space}" for space in ("2d", "3d") for part in ("face", "hand_left", "hand_right")]
    return {"person_id": [-1], "pose_keypoints_2d": points(count), **{field: [] for field in empty}}


@pytest.mark.parametrize(
    ("count", "layout"), [(17, "coco-17"), (26, "halpe-26"), (133, "coco-wholebody-133"), (25, "body-25")]
)
def test_points_of_rtmpose_in_form_of_openpose(tmp_path: Path, count: int, layout: str) -> None:
    folder = tmp_path / "cam01_json"
    folder.mkdir()
    unseen = pose2sim(count) | {"pose_keypoints_2d": [0.0] * 3 * count}
    # A frame of Pose2Sim's demonstration of several people has such a person, of whom nothing was found.
    absent = pose2sim(count) | {"pose_keypoints_2d": []}
    for number, people_of_frame in enumerate(([pose2sim(count), {}, absent], [{}], [unseen], [absent])):
        content = json.dumps({"version": 1.3, "people": people_of_frame})
        (folder / f"cam01_{number:06d}.json").write_text(content)
    problems: list[Problem] = []
    contents = read_folder(folder, "cam01", None, 10**9, [], problems)
    assert not problems
    assert contents.forms == {"OpenPose"}
    layout_points, joints = LAYOUTS[layout].points, LAYOUTS[layout].joints
    found = positions(contents, 0, joints.names)
    assert found == {name: 10.0 * layout_points.index(name) for name in joints.names}
    assert [len(contents.frames[number]) for number in range(4)] == [1, 0, 0, 0]
    assert find_joint_set({people_of_frame.shape[1] for people_of_frame in contents.frames.values()} - {0}) == joints


FRAMES: dict[str, Any] = {
    "OpenPose": {"people": [{"pose_keypoints_2d": points(17)}]},
    "EasyMocap": {"annots": [{"keypoints": [[10.0 * k, 10.0 * k + 1.0, 0.5] for k in range(25)]}]},
    "MMPose": [{"keypoints": [[10.0 * k, 10.0 * k + 1.0] for k in range(17)], "keypoint_scores": [0.5] * 17}],
    "COCO": [{"keypoints": points(17)}],
    "MediaPipe": {"pose_landmarks": [[{"x": 0.1, "y": 0.2, "visibility": 0.5}] * 33]},
    "AlphaPose": {"bodies": [{"joints": points(18)}]},
}


@pytest.mark.parametrize("program", FRAMES)
@pytest.mark.parametrize(("name", "number"), [("000000.json", 0), ("cam01_000123.json", 123)])
def test_read_folder_single_frame_has_number_of_name(tmp_path: Path, program: str, name: str, number: int) -> None:
    contents, problems = read(tmp_path, FRAMES[program], name)
    assert not problems
    assert contents.forms == {program}
    assert {frame: len(people_of_frame) for frame, people_of_frame in contents.frames.items()} == {number: 1}


@pytest.mark.parametrize("program", sorted(FRAMES.keys() - {"COCO"}))  # its people may state their frames
def test_read_folder_one_frame_without_number_is_refused(tmp_path: Path, program: str) -> None:
    _, problems = read(tmp_path, FRAMES[program], "people.json")
    assert [problem.code for problem in problems] == ["keypoints_unreadable"]
    assert problems[0].message.endswith("Name it like 000000.json.")


def test_read_folder_single_file_keeps_its_numbers(tmp_path: Path) -> None:
    person = {"image_id": "0031.jpg", "keypoints": points(17)}
    contents, problems = read(tmp_path, [person, person | {"image_id": "0032.jpg"}], "cam2.json")
    assert (list(contents.frames), problems) == ([31, 32], [])


def test_folders_as_pose2sim_names_them(tmp_path: Path, simulation: Simulation) -> None:
    write_session(simulation, "EasyMocap", tmp_path)
    for camera in simulation.cameras:
        (tmp_path / "keypoints" / camera.name).rename(tmp_path / "keypoints" / f"{camera.name}_json")
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    assert session.folders == {camera.name: f"{camera.name}_json" for camera in simulation.cameras}


def test_points_without_number_in_form_of_pose2sim(tmp_path: Path) -> None:
    text = json.dumps({"version": 1.3, "people": [pose2sim(26)]})
    contents, problems = read(tmp_path, text.replace("160.0, 161.0, 0.5", "NaN, NaN, NaN"), "cam01.0031.json")
    assert (list(contents.frames), problems) == ([31], [])
    folder = tmp_path / "cam"
    (folder / "cam01.0032.json").write_text(text.replace("160.0, 161.0, 0.5", "NaN, NaN, NaN"))
    problems = []
    contents = read_folder(folder, "left", None, 10**9, [], problems)
    assert not problems
    assert list(contents.frames) == [31, 32]
    assert not people.is_detected(contents.frames[32])[0, BODY_FEET.index("right_ankle")]


def test_hands_of_easymocap(tmp_path: Path) -> None:
    def rows(count: int) -> list[list[float]]:
        return [[10.0 * k, 10.0 * k + 1.0, 0.5] for k in range(count)]

    unseen = [[0.0, 0.0, -1.0]] * 25
    frame = {
        "filename": "images/1/000004.jpg",
        "height": 480,
        "width": 640,
        "annots": [
            {"personID": 0, "bbox": [0, 0, 9, 9, 0.9], "keypoints": rows(25), "handl2d": rows(21), "handr2d": rows(21)},
            {"personID": 1, "bbox": [0, 0, 100, 100, 0], "keypoints": unseen},
        ],
        "isKeyframe": False,
    }
    folder = tmp_path / "1"
    folder.mkdir()
    for number, content in enumerate((frame, frame | {"annots": []}, frame["annots"])):
        (folder / f"{number:06d}.json").write_text(json.dumps(content))
    problems: list[Problem] = []
    contents = read_folder(folder, "left", None, 10**9, [], problems)
    assert not problems
    assert contents.forms == {"EasyMocap"}
    assert [len(contents.frames[number]) for number in range(3)] == [1, 0, 1]
    found = contents.frames[0][0]
    assert found.shape == (65, 3)
    assert found[BODY_25.index("right_heel")].tolist() == [240.0, 241.0, 0.5]
    assert found[25].tolist() == [10.0, 11.0, 0.5]  # left thumb, after the wrist
    np.testing.assert_array_equal(contents.frames[2], contents.frames[0])


@pytest.mark.parametrize(
    ("annots", "field", "words"),
    [
        ([{"personID": 0, "bbox": [0, 0, 9, 9, 1]}], "keypoints", "only boxes"),
        ([{"keypoints": [[1.0, 2.0, 0.5]] * 24}], "keypoints", "24 points"),
        ([{"keypoints": [[1.0, 2.0]] * 25}], "keypoints", "x, y and score"),
        ([{"keypoints": [[1.0, 2.0, 0.5]] * 25}, {"keypoints": [[1.0, 2.0, 0.5]] * 17}], "keypoints", "51 numbers"),
        ([{"keypoints": [[1e9, 2.0, 0.5]] * 25}], None, "not within"),
        ([{"keypoints": [[1.0, 2.0, 0.5]] * 25, "handl2d": [[1.0, 2.0, 0.5]]}], "handl2d", "3 numbers"),
        ([{"keypoints": [[1.0, "2", 0.5]] * 25}], None, "known format"),
        ([{"keypoints": [[1.0, [[2.0]], 0.5]] * 25}], None, "known format"),
        ({"personID": 0}, None, "known format"),
        ([3], None, "known format"),
        ([{"keypoints": [[1.0, 2.0, 0.5]] * 25}] * 129, None, "129 people"),
        ([{"keypoints": [[0.0, 0.0, 0.0]] * 25}] * 1001, None, "1001 people"),
    ],
    ids=map(str, range(12)),
)  # fmt: skip
def test_wrong_people_of_easymocap(tmp_path: Path, annots: Any, field: str | None, words: str) -> None:
    for number in (0, 1):
        (tmp_path / f"{number:06d}.json").write_text(json.dumps({"annots": annots if number else []}))
    problems: list[Problem] = []
    contents = read_folder(tmp_path, "left", None, 10**9, [], problems)
    (problem,) = problems
    assert list(contents.frames) == [0]
    assert problem.field == field
    assert words in problem.message


def test_bodies_of_alphapose_s_form_cmu(tmp_path: Path) -> None:
    image = {"version": "AlphaPose v0.3", "bodies": [{"joints": points(18)}]}
    contents, problems = read(tmp_path, {"7.jpg": image, "8.jpg": {"version": "AlphaPose v0.3", "bodies": []}})
    assert not problems
    assert positions(contents, 7, COCO_18.names)["neck"] == 10.0
    assert len(contents.frames[8]) == 0


def test_frames_of_alphapose_in_files_of_their_own(tmp_path: Path) -> None:
    folder = tmp_path / "sep-json"
    folder.mkdir()
    for number in (0, 12):
        image = {"version": "AlphaPose v0.3", "people": [{"pose_keypoints_2d": points(18)}]}
        (folder / f"{number}.json").write_text(json.dumps(image))
    problems: list[Problem] = []
    contents = read_folder(folder, "left", None, 10**9, [], problems)
    assert not problems
    assert list(contents.frames) == [0, 12]


def mmpose(count: int, names: Sequence[str] | None = None) -> Any:
    instance = {
        "keypoints": [[10.0 * k, 10.0 * k + 1.0] for k in range(count)],
        "keypoint_scores": [0.5] * count,
    }
    frames = [{"frame_id": 4, "instances": [instance]}, {"frame_id": 5, "instances": []}]
    if names is None:
        return frames
    return {"meta_info": {"keypoint_id2name": {str(k): name for k, name in enumerate(names)}}, "instance_info": frames}


def test_points_of_mmpose_by_their_number_or_their_names(tmp_path: Path) -> None:
    contents, problems = read(tmp_path, mmpose(133))
    assert not problems
    assert positions(contents, 4, WHOLE_BODY.names)["left_thumb_cmc"] == 920.0
    assert len(contents.frames[5]) == 0
    (tmp_path / "other").mkdir()
    reversed_names = COCO_17.names[::-1]
    contents, problems = read(tmp_path / "other", mmpose(17, reversed_names))
    assert not problems
    assert positions(contents, 4, COCO_17.names)["nose"] == 160.0


def test_points_that_coco_s_categories_name(tmp_path: Path) -> None:
    names = ["nose", "head_bottom", "head_top", *COCO_17.names[3:]]  # PoseTrack's
    document = {
        "images": [{"id": 10_000_100, "file_name": "000010_mpii/000002.jpg"}],
        "categories": [{"id": 1, "keypoints": names}, {"id": 2, "name": "chair"}],
        "annotations": [
            {"image_id": 10_000_100, "category_id": 1, "keypoints": points(17)},
            {"image_id": 10_000_100, "category_id": 2, "bbox": [0, 0, 5, 5]},
        ],
    }
    contents, problems = read(tmp_path, document)
    assert not problems
    assert contents.own == ("head_bottom", "head_top")
    people, own = split_own(contents.frames, contents.own, contents.own)
    assert people[2].shape == (1, 17, 3)
    assert own.of_people[0].tolist() == [[[10.0, 11.0, 0.5], [20.0, 21.0, 0.5]]]
    found = people[2][0]
    assert found[COCO_17.index("left_wrist"), 0] == 90.0
    assert found[COCO_17.index("left_eye"), 2] == 0.0


SINGLE = [
    "scorer," + ",".join(["DLC"] * 15),
    "bodyparts," + ",".join(name for name in ("LHip", "RHip", "shoulder2", "shoulder1", "tail") for _ in range(3)),
    "coords," + ",".join(["x,y,likelihood"] * 5),
]


def test_rows_of_one_person_of_deeplabcut(tmp_path: Path) -> None:
    rows = ["0," + ",".join(map(str, points(5))), "1," + "," * 14, "3," + ",".join(["nan", "", "1e400"] * 5)]
    contents, problems = read(tmp_path, "\n".join([*SINGLE, *rows]), "camDLC_resnet50.csv")
    assert not problems
    assert contents.forms == {"DeepLabCut"}
    frames, own = split_own(contents.frames, contents.own, contents.own)
    assert {number: len(people) for number, people in frames.items()} == {0: 1, 1: 0, 3: 0}
    assert contents.own == ("tail",)
    assert own.of_people[0].tolist() == [[[40.0, 41.0, 0.5]]]
    found = positions(replace(contents, frames=frames), 0, COCO_17.names)
    seen = {"left_hip": 0.0, "right_hip": 10.0, "left_shoulder": 20.0, "right_shoulder": 30.0}
    assert {name: x for name, x in found.items() if name in seen} == seen
    assert (frames[0][0, :5, 2] == 0).all()


def test_points_of_scene_beyond_the_limit_are_an_error(tmp_path: Path) -> None:
    names = ["left_hip", "right_hip", "left_shoulder", "right_shoulder", *(f"spot {k}" for k in range(201))]
    owners = ["me"] * 4 + ["single"] * 201
    rows = (("scorer", ["x"] * 205), ("individuals", owners), ("bodyparts", names))
    header = [",".join([key, *(cell for cell in cells for _ in range(2))]) for key, cells in rows]
    lines = [*header, "coords," + ",".join(["x,y"] * 205), "0," + ",".join(["5"] * 410)]
    _, problems = read(tmp_path, "\n".join(lines), "camDLC_resnet50.csv")
    assert ["name 201 points that are no joints" in problem.message for problem in problems] == [True]


def test_deeplabcut_labels_name_pictures_without_likelihood(tmp_path: Path) -> None:
    parts = ["left_hip", "right_hip", "left_shoulder", "right_shoulder", "corner"]
    header = [
        "scorer,,," + ",".join(["me"] * 10),
        "individuals,,," + ",".join(["mim"] * 8 + ["single"] * 2),
        "bodyparts,,," + ",".join(part for part in parts for _ in range(2)),
        "coords,,," + ",".join(["x,y"] * 5),
    ]
    row = "labeled-data,cam2,img0042.png," + ",".join(str(10.0 * k) for k in range(10))
    contents, problems = read(tmp_path, "\n".join([*header, row]), "CollectedData_me.csv")
    assert not problems
    frames, own = split_own(contents.frames, contents.own, contents.own)
    people = frames[42]
    assert people.shape == (1, 17, 3)
    assert contents.own == ("corner",)
    assert [own.of_people[0].shape, own.of_scene[0].tolist()] == [(1, 1, 3), [[[80.0, 90.0, 1.0]]]]
    assert people[0, COCO_17.index("right_shoulder")].tolist() == [60.0, 70.0, 1.0]


def landmarks(x: float, y: float, count: int = 33) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "z": 0.0, "visibility": 0.9}] * count


@pytest.mark.parametrize(
    "result",
    [
        {"pose_landmarks": [landmarks(0.5, 0.25)], "pose_world_landmarks": [landmarks(0.0, 0.0)]},
        {"landmarks": [landmarks(0.5, 0.25)], "worldLandmarks": [landmarks(0.0, 0.0)]},
        {"poseLandmarks": landmarks(0.5, 0.25), "leftHandLandmarks": landmarks(0.1, 0.1, 21)},
        {"pose_landmarks": {"landmark": landmarks(0.5, 0.25)}, "left_hand_landmarks": None},
        {"pose_landmarks": landmarks(0.5, 0.25), "left_hand_landmarks": landmarks(0.1, 0.1, 21)},
    ],
    ids=["Python", "JavaScript", "older JavaScript", "older Python", "holistic"],
)
def test_results_of_mediapipe_are_shares_of_image(tmp_path: Path, result: Any) -> None:
    contents, problems = read(tmp_path, [None, result, {"frame": 8, "image_size": [100, 100], **result}])
    assert not problems
    assert contents.forms == {"MediaPipe"}
    has_hand = any("hand" in name.lower() and value for name, value in result.items())
    assert {k: people.shape[:2] for k, people in contents.frames.items()} == {
        0: (0, 0),
        1: (1, 61 if has_hand else 21),
        8: (1, 61 if has_hand else 21),
    }
    np.testing.assert_array_equal(contents.frames[1][0, :21], np.tile([319.5, 119.5, 0.9], (21, 1)))
    np.testing.assert_array_equal(contents.frames[8][0, 0, :2], [49.5, 24.5])


@pytest.mark.parametrize(
    ("name", "joint"),
    [
        ("left_shoulder", "left_shoulder"),
        ("RAnkle", "right_ankle"),
        ("Rknee", "right_knee"),
        ("lelbow", "left_elbow"),
        ("hip_l", "left_hip"),
        ("ankle1", "right_ankle"),
        ("wrist2", "left_wrist"),
        ("left big toe", "left_big_toe"),
        ("LEFT_FOOT_INDEX", "left_big_toe"),
        ("LBigToe", "left_big_toe"),
        ("rightEar", "right_ear"),
        ("nose", "nose"),
        ("left_small_toe", None),
        ("left_hand_root", None),
        ("left_thumb1", None),
        ("leftright_knee", None),
        ("knee", None),
        ("L" * 10_000, None),
    ],
)
def test_names_of_points(name: str, joint: str | None) -> None:
    assert match_joint(name) == joint


UPPER = ["nose", "l_eye", "r_eye", *(f"{side}_{part}" for side in "lr" for part in ("shoulder", "elbow", "wrist"))]


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        (UPPER, "left_hip, right_hip"),
        ([*UPPER, "Neck", "Top of head", "left_thumb_3", "RHand"], "left_hip, right_hip"),
        (["LHip", "RHip", "LKnee", "RKnee", "LAnkle", "RAnkle", "LBigToe"], "left_shoulder, right_shoulder"),
        (["nose", "left_ear", "right_ear"], "left_shoulder, right_shoulder, left_hip, right_hip"),
    ],
)
def test_people_without_trunk_are_no_animals(names: list[str], missing: str) -> None:
    with pytest.raises(KeypointsError, match=f"joints {missing}; shoulders and hips are required. Add them"):
        named_layout(names, "names")
    animal = named_layout([*names, "tail_base"], "names")
    assert not animal.has_people
    assert len(animal.own) == len(names) + 1


BODY = {"keypoints": points(17)}


@pytest.mark.parametrize(
    ("name", "content", "field", "words"),
    [
        ("take.json", [BODY | {"image_id": "cover.jpg"}], "image_id", "no number"),
        ("take.json", [BODY | {"image_id": "1.jpg"}, BODY | {"image_id": "01.jpg"}], "image_id", "the same frame"),
        ("take.json", [BODY | {"image_id": "1.jpg"}, BODY | {"image_id": 1}], "image_id", "the same frame"),
        ("take.json", [BODY | {"image_id": "1.jpg"}, BODY | {"image_id": []}], "image_id", "whole number"),
        ("take.json", [{"image_id": "1.jpg", "keypoints": points(16)}], "keypoints", "16 points"),
        ("take.json", [BODY | {"image_id": "1.jpg"}, {"image_id": "1.jpg", "keypoints": points(26)}], "keypoints", ""),
        ("take.json", [{"image_id": "1.jpg", "keypoints": ["1"] * 51}], None, "known format"),
        ("take.json", [{"image_id": "1.jpg", "keypoints": [1e300, 1.0, 1.0] * 17}], None, "not within"),
        ("take.json", [{"image_id": "1.jpg", "keypoints": None}], None, "known format"),
        ("take.json", {"a.jpg": {"people": []}}, "image_id", "no number"),
        ("take.json", {"a.jpg": [BODY]}, "image_id", "no number"),
        ("take.json", {"1.jpg": [BODY], "2.jpg": [3]}, None, "known format"),
        ("take.json", {"shapes": [{"points": []}]}, None, "single frame"),
        ("take.json", {"1.jpg": {"bodies": [{"joints": points(17)}]}, "2.jpg": 3}, None, "known format"),
        ("take.json", [{"frame_id": 1, "instances": []}] * 2, "frame_id", "listed twice"),
        ("take.json", [{"frame_id": 1.5, "instances": []}], "frame_id", "whole number"),
        ("take.json", [{"frame_id": 1, "instances": {}}], None, "known format"),
        ("take.json", mmpose(16), "keypoints", "16 points"),
        ("take.json", mmpose(17, COCO_17.names[:16]), "keypoints", "names 16"),
        ("take.json", mmpose(17, [*COCO_17.names[:-1], "LAnkle"]), "keypoint_id2name", "left_ankle, LAnkle"),
        ("take.json", mmpose(17, ["a"] * 17), "keypoint_id2name", "the name 'a'"),
        ("take.json", mmpose(2000, ["a"] * 2000), "keypoint_id2name", "at most 1000"),
        ("take.json", [{"frame_id": 0, "instances": [{"keypoints": [[1, 2]] * 17, "keypoint_scores": [1]}]}],
         "keypoint_scores", "17 points and 1 scores"),
        ("take.json", [{"frame_id": 0, "instances": [{"keypoints": [[1, 2, 3]] * 17, "keypoint_scores": [1] * 17}]}],
         "keypoints", "x and y"),
        ("take.json", [{"frame_id": 0, "instances": [{"keypoints": [[1, [2]]] * 17, "keypoint_scores": [1] * 17}]}],
         None, "known format"),
        ("take.json", [{"keypoints": [[1, 2]] * 17, "keypoint_scores": [1] * 17}], None, "single frame"),
        ("take.json", {"annotations": [BODY | {"image_id": 1, "category_id": 1}],
                       "categories": [{"id": 1, "keypoints": ["paw"] * 3}]}, "categories", "the name 'paw'"),
        ("take.json", {"annotations": [], "images": [{"id": 1}, {"id": "x"}]}, "id", "whole number"),
        ("take.json", {"annotations": [BODY | {"category_id": []}], "categories": [{"id": 1, "keypoints": ["nose"]}]},
         None, "known format"),
        ("take.json", [{"pose_landmarks": landmarks(1e8, 0.5)}], None, "not within"),
        ("take.json", [{"pose_landmarks": [landmarks(0.5, 0.5)] * 2, "left_hand_landmarks": landmarks(0, 0, 21)}],
         "left_hand_landmarks", "1 left hands of 2 poses"),
        ("take.json", [{"pose_landmarks": landmarks(0.5, 0.5, 32)}], "pose_landmarks", "32 landmarks"),
        ("take.json", [{"pose_landmarks": [None]}], "pose_landmarks", "1 landmarks"),
        ("take.json", [{"pose_landmarks": {"landmark": 3}}], None, "known format"),
        ("take.json", [{"frame": 1, "landmarks": []}, {"landmarks": []}], "frame", "listed twice"),
        ("take.csv", "a,b\n1,2\n", None, "scorer"),
        ("take.csv", "scorer,a\ncoords,x\n0,1\n", None, "bodyparts"),
        ("take.csv", "scorer,a\nbodyparts,LHip\n", None, "coords"),
        ("take.csv", "scorer,a\n7,LHip\n", None, "individuals"),
        ("take.csv", "scorer,a,a\nbodyparts,LHip\ncoords,x\n", None, "different numbers of cells"),
        ("take.csv", "scorer,a\nbodyparts,LHip\ncoords,z\n", "bodyparts", "left_shoulder"),
        ("take.csv", 'scorer,"a\nbodyparts,LHip\ncoords,x\n', None, "read as CSV"),
        ("take.csv", "\n".join([*SINGLE, "0," + ",".join(["1"] * 14 + ["1e5x"])]), "tail likelihood", "'1e5x'"),
        ("take.csv", "\n".join([*SINGLE, "0,1,2"]), None, "3 cells; the headers have 16"),
        ("take.csv", "\n".join([*SINGLE, "0" + ",1" * 15, "0" + ",1" * 15]), "frame", "listed twice"),
        ("take.csv", "\n".join([*SINGLE, "one" + ",1" * 15]), "frame", "whole number"),
        ("take.csv", "\n".join([*SINGLE, "9" * 400 + ",1" * 15]), "frame", "whole number"),
        ("take.csv", "\n".join([*SINGLE, "0" + ",1e300" * 15]), None, "not within"),
        ("take.csv", "\n".join(line + "," + line.split(",", 1)[1] for line in SINGLE), "LHip x", "Two columns"),
    ],
    ids=map(str, range(100)),
)  # fmt: skip
def test_wrong_files_are_named_with_frame_and_field(
    tmp_path: Path, name: str, content: Any, field: str | None, words: str
) -> None:
    contents, problems = read(tmp_path, content, name)
    assert problems, contents.frames
    problem = problems[0]
    assert (problem.code, problem.file) == ("keypoints_unreadable", f"cam/{name}")
    assert problem.field == field, problem
    assert words in problem.message


def test_cell_of_any_length(tmp_path: Path) -> None:
    _, problems = read(tmp_path, "scorer,a\nbodyparts," + "x" * 200_000, "take.csv")
    assert "read as CSV" in problems[0].message


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_bytes(b"scorer,\xff\xfe\n")
    problems: list[Problem] = []
    read_folder(tmp_path, "left", None, 10**9, [], problems)
    assert "known format" in problems[0].message


def test_file_of_endless_frames_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(people, "MAX_OUTPUT_FRAMES", 1000)
    begun = time.monotonic()
    contents, problems = read(tmp_path, "[" + "null," * 10**6 + '{"landmarks": []}]')
    assert time.monotonic() - begun < 10.0
    assert not contents.frames
    assert "at most 1,000" in problems[0].message


def test_several_files_without_numbers_are_named(tmp_path: Path) -> None:
    for name in ("camDLC.csv", "camDLC_filtered.csv"):
        (tmp_path / name).write_text("\n".join(SINGLE))
    problems: list[Problem] = []
    read_folder(tmp_path, "left", None, 10**9, [], problems)
    (problem,) = problems
    assert problem.code == "keypoints_none"
    assert "camDLC.csv, camDLC_filtered.csv" in problem.message


def test_problems_of_folder_are_counted_not_kept(tmp_path: Path) -> None:
    _, problems = read(tmp_path, [BODY | {"image_id": f"{k}.jpg", "keypoints": [1.0]} for k in range(40)])
    assert len(problems) == 11
    assert problems[-1].message == "30 more frames have problems."
