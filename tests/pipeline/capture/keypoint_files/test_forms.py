"""Forms of files: two forms in a folder or a file, and files of other kinds."""

import io
import json
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoint_files.folders import Contents, camera_folders, read_folder
from pipeline.capture.keypoint_files.forms import find_reader, keypoint_readers
from pipeline.capture.keypoint_files.points import KeypointReading
from pipeline.capture.keypoints_zip import unpack_keypoints
from pipeline.core.errors import InputError, Problem

SIZE_PX = (640, 480)
LABELS = "0 0.5 0.5 0.1 0.1" + " 0.5" * 51


def test_each_field_tells_one_format() -> None:
    counts = Counter(field for reader in keypoint_readers() for field in reader.fields)
    assert len(counts) == 9
    assert set(counts.values()) == {1}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"people": [], "version": 1}, "OpenPose"),
        ({"annotations": [{"keypoints": [1.0]}]}, "COCO"),
        ({"a1.jpg": [{"keypoints": [1.0]}]}, "AlphaPose"),
        ({"frames": []}, "MediaPipe"),
        ([{"image_id": "1.jpg", "keypoints": [[1.0, 2.0, 0.5]]}], "EasyMocap"),
        ([{"image_id": "1.jpg", "keypoints": [1.0, 2.0, 0.5]}], "AlphaPose"),
        ([{"image_id": 1, "keypoints": [1.0, 2.0, 0.5]}], "COCO"),
        ([3, {"keypoints": [[1.0, 2.0]], "keypoint_scores": [0.5]}], "MMPose"),
        ([], "COCO"),
        (3, "OpenPose"),
    ],
)
def test_content_tells_program(content: Any, expected: str) -> None:
    assert find_reader(Path("take.json"), content).name == expected


def test_layout_of_reading_by_names_or_number() -> None:
    reading = KeypointReading(SIZE_PX)
    names = ["tail", *(f"{part}_{side}" for part in ("hip", "shoulder") for side in "LR")]
    joints = [None, "left_hip", "right_hip", "left_shoulder", "right_shoulder"]
    assert (list(reading.layout(names, "bodyparts").points), reading.counts) == (joints, set())
    assert (reading.layout(26, "points").name, reading.counts) == ("halpe-26", {26})


@pytest.mark.parametrize("other", ["000001.json", "take.csv", "frame_1_keypoints.json"])
def test_files_of_two_forms_are_named(tmp_path: Path, other: str) -> None:
    folder = tmp_path / "cam"
    folder.mkdir()
    (folder / other).write_text(json.dumps({"people": []}))
    contents, problems = labels_beside(folder, LABELS)
    assert not contents.frames
    (problem,) = problems
    assert problem.code == "keypoints_none"
    assert f"{other} and YOLO's labels walk_1.txt" in problem.message


def labels_beside(folder: Path, text: str) -> tuple[Contents, list[Problem]]:
    (folder / "walk_1.txt").write_text(text)
    problems: list[Problem] = []
    return read_folder(folder, "left", SIZE_PX, 10**9, [], problems), problems


def test_notes_beside_keypoints_are_no_labels(tmp_path: Path) -> None:
    (tmp_path / "frame_1_keypoints.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": [5.0] * 51}]}))
    contents, problems = labels_beside(tmp_path, "Filmed on day 2, take 1")
    assert not problems
    assert contents.forms == {"OpenPose"}


def test_object_of_two_formats_is_named(tmp_path: Path) -> None:
    for number in (1, 2):
        (tmp_path / f"{number:06d}.json").write_text(json.dumps({"annots": [], "people": []}))
    problems: list[Problem] = []
    read_folder(tmp_path, "left", SIZE_PX, 10**9, [], problems)
    assert "annots of EasyMocap and people of OpenPose" in problems[0].message


def test_files_of_cameras_in_one_folder_are_told_where_to_go(tmp_path: Path) -> None:
    for name in ("left.csv", "right.csv"):
        (tmp_path / name).write_bytes(b"")
    problems: list[Problem] = []
    camera_folders(tmp_path, [], problems)
    assert [problem.code for problem in problems] == ["too_few_folders"]
    assert "such as left/left.csv" in (problems[0].hint or "")


@pytest.mark.parametrize(
    ("name", "words", "advice"),
    [
        ("labels.v001.slp", "SLEAP's project", "Export Analysis HDF5"),
        ("camDLC_full.pickle", "a pickle", "its HDF5 or CSV"),
        ("walk.c3d", "C3D, points in 3D", "2D keypoints"),
        ("walk.trc", "TRC, points in 3D", "2D keypoints"),
        ("cam1.mp4", "a video", "as videos"),
        ("0001_keypoints.yml", "OpenPose's of --write_keypoint", "--write_json"),
    ],
)
def test_files_that_are_not_read_are_named_for_what_they_are(
    tmp_path: Path, name: str, words: str, advice: str
) -> None:
    folder = tmp_path / "cam"
    folder.mkdir()
    (folder / name).write_bytes(b"\x89HDF")
    problems: list[Problem] = []
    read_folder(folder, "left", SIZE_PX, 10**9, [], problems)
    (problem,) = problems
    assert problem.code == "keypoints_none"
    assert f"{name} is {words}, which is not read." in problem.message
    assert advice in (problem.hint or "")

    (tmp_path / name).write_bytes(b"\x89HDF")
    camera_folders(tmp_path, [], problems)
    assert problems[-1].code == "too_few_folders"
    assert f"{name} is {words}, which is not read." in problems[-1].message

    archive = tmp_path / "left.zip"
    with zipfile.ZipFile(archive, "w") as entries:
        entries.writestr(name, b"\x89HDF")
    (tmp_path / "unpacked").mkdir()
    with pytest.raises(InputError, match=words) as raised:
        unpack_keypoints([archive], tmp_path / "unpacked")
    assert [problem.code for problem in raised.value.problems] == ["keypoints_archive"]


def npy(array: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


WHOLE_FILES = {
    "EasyMocap": (
        "1.json",
        json.dumps({"annots": [{"keypoints": [[1.0, 2.0, 0.5]] * 25, "handl2d": [[1.0, 2.0, 0.5]] * 21}]}).encode(),
    ),
    "Pose2Sim": ("1.json", json.dumps({"people": [{"pose_keypoints_2d": [0.5] * 78}, {}]}).encode()),
    "PoseFlow": ("take.json", json.dumps({f"{k}.jpg": [{"keypoints": [0.5] * 51, "idx": 1}] for k in (1, 2)}).encode()),
    "YOLO": ("1.txt", f"{LABELS}\n{LABELS}\n".encode()),
    "FreeMoCap": ("points.npy", npy(np.ones((2, 75, 3)))),
}
DAMAGE = [b"null", b"NaN", b"1e999", b"[", b"]", b"{", b'"x"', b"9" * 400, b"\xff", b"\x00", b",", b" ", b""]


@pytest.mark.parametrize("program", WHOLE_FILES)
def test_damaged_files_are_read_or_refused(tmp_path: Path, program: str) -> None:
    rng = np.random.default_rng(7)
    name, whole = WHOLE_FILES[program]
    if name == "1.json":
        (tmp_path / "2.json").write_text(json.dumps({"people": []}))
    refused = 0
    for _ in range(60):
        damaged = bytearray(whole)
        for _ in range(rng.integers(1, 6)):
            at = int(rng.integers(100 if rng.random() < 0.5 else len(damaged)))
            damaged[at : at + int(rng.integers(6))] = DAMAGE[rng.integers(len(DAMAGE))]
        (tmp_path / name).write_bytes(damaged)
        problems: list[Problem] = []
        contents = read_folder(tmp_path, "left", SIZE_PX, 10**6, [], problems)
        assert {problem.code for problem in problems} <= {"keypoints_unreadable", "keypoints_none"}
        assert problems or 1 <= len(contents.frames) <= 2
        refused += bool(problems)
    assert refused > 10
