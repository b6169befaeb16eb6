"""Readers of keypoint files: points of each format, and messages of what can't be read."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoint_files.folders import read_folder
from pipeline.capture.keypoint_files.people import JOINT_SETS, People, find_joint_set
from pipeline.core.errors import Problem
from pipeline.core.findings import Finding
from pipeline.core.joints import BODY_25, BODY_FEET, COCO_17, WHOLE_BODY, JointSet, without_hands
from pipeline.core.layouts import LAYOUTS

Numbers = list[float]


def points(count: int, start: int = 0) -> Numbers:
    """X, y and score of points: point k is at (10 k, 10 k + 1)."""
    return [value for k in range(start, start + count) for value in (10.0 * k, 10.0 * k + 1.0, 0.5)]


def landmarks(count: int, start: int = 0, **more: float) -> list[dict[str, float]]:
    return [{"x": 10.0 * k, "y": 10.0 * k + 1.0, "z": 0.0, **more} for k in range(start, start + count)]


def read(folder: Path, **contents: Any) -> tuple[dict[int, People], list[Problem], list[Finding]]:
    """Read a folder with files of these names, without the ending, and contents."""
    folder = folder / "cam"
    folder.mkdir()
    for name, content in contents.items():
        (folder / f"{name}.json").write_text(content if isinstance(content, str) else json.dumps(content))
    problems: list[Problem] = []
    findings: list[Finding] = []
    read_contents = read_folder(folder, "left", None, 10**9, findings, problems)
    return read_contents.frames, problems, findings


def positions(people: People, joints: JointSet) -> dict[str, tuple[float, ...]]:
    """X and y of the first person's joints by name."""
    assert people.shape[1] == len(joints.names)
    return {name: tuple(people[0, k, :2].tolist()) for k, name in enumerate(joints.names)}


def at(point: int) -> tuple[float, float]:
    return 10.0 * point, 10.0 * point + 1.0


def test_every_number_of_joints_is_one_set() -> None:
    assert set(map(len, (joints.names for joints in JOINT_SETS.values()))) == {17, 18, 21, 25, 57, 58, 61, 65}
    assert JOINT_SETS[61] == WHOLE_BODY
    assert without_hands(JOINT_SETS[65]) == BODY_25
    assert find_joint_set({25}) == BODY_25
    assert find_joint_set({25, 65}) == JOINT_SETS[65]
    assert find_joint_set({21, 65}) is None
    assert find_joint_set({17, 25}) is None


def test_hands_of_openpose_lose_their_wrists(tmp_path: Path) -> None:
    person = {
        "pose_keypoints_2d": points(25),
        "hand_left_keypoints_2d": points(21, 100),
        "hand_right_keypoints_2d": points(21, 200),
    }
    frames, problems, _ = read(tmp_path, frame_7_keypoints={"people": [person]})
    assert not problems
    found = positions(frames[7], JOINT_SETS[65])
    assert found["left_wrist"] == at(7)  # the body's
    assert found["left_thumb_cmc"] == at(101)
    assert found["left_pinky_tip"] == at(120)
    assert found["right_index_mcp"] == at(205)
    np.testing.assert_array_equal(frames[7][..., 2], 0.5)


def test_hands_of_openpose_that_were_not_found(tmp_path: Path) -> None:
    one = {"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": [], "hand_right_keypoints_2d": points(21, 200)}
    other = {"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": [0.0] * 63, "hand_right_keypoints_2d": []}
    frames, problems, _ = read(
        tmp_path, frame_0_keypoints={"people": [one, other]}, frame_1_keypoints={"people": [other]}
    )
    assert not problems
    assert frames[0].shape == (2, 65, 3)
    assert (frames[0][0, 25:45, 2] == 0).all()
    assert (frames[0][0, 45:, 2] == 0.5).all()
    assert (frames[0][1, 25:, 2] == 0).all()
    assert frames[1].shape == (1, 25, 3)


def wholebody(form: str) -> dict[str, Any]:
    """Person of COCO-WholeBody with all points in one list, or in a list a part."""
    if form == "one list":
        return {"image_id": 3, "category_id": 1, "keypoints": points(133), "score": 0.9}
    return {
        "image_id": 3,
        "keypoints": points(17),
        "foot_kpts": points(6, 17),
        "face_kpts": points(68, 23),
        "lefthand_kpts": points(21, 91),
        "righthand_kpts": points(21, 112),
    }


@pytest.mark.parametrize("form", ["one list", "a list a part"])
@pytest.mark.parametrize("file", ["frame_3_keypoints", "results"])
@pytest.mark.parametrize("wrap", [list, lambda people: {"images": [{"id": 3}, {"id": 4}], "annotations": people}])
def test_coco_wholebody(tmp_path: Path, form: str, file: str, wrap: Callable[[Any], Any]) -> None:
    frames, problems, findings = read(tmp_path, **{file: wrap([wholebody(form), wholebody(form)])})
    assert not problems
    assert not findings
    assert frames[3].shape == (2, 61, 3)
    found = positions(frames[3], WHOLE_BODY)
    assert found["right_ankle"] == at(16)
    assert found["left_big_toe"] == at(17)
    assert found["left_heel"] == at(19)
    assert found["right_big_toe"] == at(20)
    assert found["right_heel"] == at(22)
    assert found["left_thumb_cmc"] == at(92)
    assert found["right_pinky_tip"] == at(132)
    if file == "results" and wrap is not list:
        assert len(frames[4]) == 0


def test_people_of_coco_wholebody_by_frame(tmp_path: Path) -> None:
    people = [wholebody("one list") | {"frame": frame, "image_id": 1} for frame in (12, 5, 12)]
    frames, problems, _ = read(tmp_path, results=people)
    assert not problems
    assert {number: len(of_frame) for number, of_frame in frames.items()} == {5: 1, 12: 2}
    assert list(frames) == [5, 12]


def test_bodies_of_coco_without_hands(tmp_path: Path) -> None:
    person = {"keypoints": points(17), "foot_kpts": points(6, 17), "lefthand_kpts": [0] * 63}
    frames, _, _ = read(tmp_path, frame_0_keypoints=[person])
    assert positions(frames[0], BODY_FEET)["right_heel"] == at(22)
    visible = points(17)
    visible[2::3] = [2.0] * 17  # as annotations say that a joint is visible
    (tmp_path / "other").mkdir()
    frames, _, _ = read(tmp_path / "other", frame_0_keypoints=[{"keypoints": visible}])
    assert (frames[0][0, 17:, 2] == 0).all()


def pose(hands: bool = True) -> dict[str, Any]:
    body = {"pose_landmarks": landmarks(33, visibility=0.25)}
    return body | {"left_hand_landmarks": landmarks(21, 100), "right_hand_landmarks": None} if hands else body


def test_mediapipe(tmp_path: Path) -> None:
    frames, problems, _ = read(tmp_path, frame_0_keypoints={"poses": [pose()]})
    assert not problems
    found = positions(frames[0], WHOLE_BODY)
    assert found["nose"] == at(0)
    assert found["left_eye"] == at(2)
    assert found["right_wrist"] == at(16)
    assert found["left_heel"] == at(29)
    assert found["right_big_toe"] == at(32)
    assert found["left_thumb_cmc"] == at(101)
    left = WHOLE_BODY.index("left_thumb_cmc")
    np.testing.assert_array_equal(frames[0][0, :21, 2], 0.25)
    np.testing.assert_array_equal(frames[0][0, left : left + 20, 2], 1.0)
    np.testing.assert_array_equal(frames[0][0, left + 20 :, 2], 0.0)


def test_shares_of_image_become_pixels(tmp_path: Path) -> None:
    center = {"pose_landmarks": [{"x": 0.5, "y": 0.0, "visibility": 1.0}] * 33}
    frames, problems, _ = read(
        tmp_path,
        take={"image_size": [640, 480], "frames": [{"frame": 9, "poses": [center]}, {"frame": 2, "poses": []}]},
    )
    assert not problems
    assert {number: len(people) for number, people in frames.items()} == {2: 0, 9: 1}
    np.testing.assert_array_equal(frames[9][0, :, :2], np.tile([319.5, -0.5], (21, 1)))


@pytest.mark.parametrize(
    ("content", "field", "words"),
    [
        ({"people": [{"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": [1.0] * 60}]},
         "hand_left_keypoints_2d", "60 numbers; 21 points have 63"),
        ({"people": [{"pose_keypoints_2d": points(24)}]}, "pose_keypoints_2d", "72 numbers"),
        ({"people": [{"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": "abc"}]}, None, "known format"),
        ({"people": [{"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": ["1"] * 63}]}, None, "known format"),
        ({"people": [{"pose_keypoints_2d": points(25), "hand_left_keypoints_2d": [1e9] * 63}]}, None, "not within"),
        ([{"keypoints": points(130)}], "keypoints", "51 or 399"),
        ([{"keypoints": points(17)}, {"keypoints": points(133)}], "keypoints", "51 or 399"),
        ([{"keypoints": points(17), "foot_kpts": [0.5] * 5}], "foot_kpts", "5 numbers"),
        ([{"keypoints": [True] * 51}], None, "known format"),
        ([{"keypoints": 3}], None, "known format"),
        ([3], None, "known format"),
        ({"annotations": 3}, None, "known format"),
        ({"poses": 3}, None, "known format"),
        ({"poses": [{"pose_landmarks": [3] * 33}]}, None, "known format"),
        ({"poses": [{"pose_landmarks": landmarks(32)}]}, "pose_landmarks", "32 landmarks"),
        ({"poses": [{"pose_landmarks": landmarks(21)}]}, "pose_landmarks", "63 numbers"),
        ({"poses": [pose()], "image_size": [0, 480]}, "image_size", "width and height"),
        ({"poses": [pose()], "image_size": "large"}, None, "known format"),
        ({"poses": [{"pose_landmarks": [{"x": None, "y": []}] * 33}]}, None, "known format"),
        ("3", None, "known format"),
        ("[" * 100_000, None, "known format"),
    ],
)  # fmt: skip
def test_wrong_frame_is_named_with_its_field(tmp_path: Path, content: Any, field: str | None, words: str) -> None:
    frames, problems, _ = read(
        tmp_path, frame_0_keypoints=content, frame_1_keypoints={"people": [{"pose_keypoints_2d": points(17)}]}
    )
    (problem,) = problems
    assert problem.code == "keypoints_unreadable"
    assert (problem.file, problem.field) == ("cam/frame_0_keypoints.json", field)
    assert words in problem.message
    assert list(frames) == [1]


@pytest.mark.parametrize(
    ("content", "field", "words"),
    [
        ({"people": []}, None, "OpenPose's of a single frame"),
        ([{"keypoints": points(17)}], "image_id", "at most 15 digits"),
        ([{"keypoints": points(17), "image_id": "twelve"}], "image_id", "no number"),
        ([{"keypoints": points(17), "frame": 10**15}], "frame", "at most 15 digits"),
        ([{"keypoints": points(17), "frame": -1}], "frame", "at most 15 digits"),
        ([{"keypoints": points(17), "frame": True}], "frame", "at most 15 digits"),
        ({"frames": [{"frame": 1, "poses": []}, {"frame": 1, "poses": []}]}, "frame", "listed twice"),
        ({"frames": {"frame": 1}}, None, "known format"),
    ],
)
def test_file_of_all_frames_that_can_not_be_split(tmp_path: Path, content: Any, field: str | None, words: str) -> None:
    frames, problems, _ = read(tmp_path, take=content)
    (problem,) = problems
    assert (problem.code, problem.file, problem.field) == ("keypoints_unreadable", "cam/take.json", field)
    assert words in problem.message
    assert not frames


def test_every_wrong_frame_of_file_is_named(tmp_path: Path) -> None:
    people = [wholebody("one list") | {"frame": 1}, {"keypoints": [], "frame": 2}, {"keypoints": [], "frame": 4}]
    crowd = [wholebody("one list") | {"frame": 6}] * 129
    frames, problems, _ = read(tmp_path, results=[*people, *crowd])
    assert list(frames) == [1]
    assert [problem.code for problem in problems] == ["keypoints_unreadable"] * 2 + ["too_many_people"]
    assert [problem.message.split()[1] for problem in problems][-1] == "6"
    assert all("rame 2" in problem.message for problem in problems[:1])
    assert all("rame 4" in problem.message for problem in problems[1:2])


def test_two_files_that_are_no_frames_are_ignored(tmp_path: Path) -> None:
    frames, problems, findings = read(tmp_path, one=[], other=[])
    assert not frames
    assert [problem.code for problem in problems] == ["keypoints_none"]
    assert "2 other files" in findings[0].message


def test_layouts_give_joints_of_readers() -> None:
    assert LAYOUTS["coco-wholebody-133"].joints == WHOLE_BODY
    assert LAYOUTS["mediapipe-33"].joints == BODY_FEET
    assert BODY_FEET.names[:17] == COCO_17.names
