"""FreeMoCap's arrays: of a camera, and of all cameras."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.capture.keypoint_files.folders import Contents, camera_folders, read_folder
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import BODY_FEET, WHOLE_BODY
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.keypoint_programs import freemocap_array, write_session


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=1.0), seed=4, num_views=2)


def array(folder: Path, content: np.ndarray | bytes) -> tuple[Contents, list[Problem]]:
    folder = folder / "cam"
    folder.mkdir()
    path = folder / "mediapipe_2dData.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content, allow_pickle=True)
    problems: list[Problem] = []
    return read_folder(folder, "left", None, 10**9, [], problems), problems


@pytest.mark.parametrize("count", [33, 75, 543, 553])
def test_arrays_of_freemocap_with_mediapipe(tmp_path: Path, count: int) -> None:
    """33 points of the pose, 21 of the right hand, 21 of the left, the face; the third number is a depth."""
    points_px = np.zeros((4, count, 3), dtype=np.float32)
    points_px[..., 0] = 10.0 * np.arange(count) + 0.5
    points_px[..., 1] = 10.0 * np.arange(count) + 1.5
    points_px[..., 2] = -300.0
    points_px[1, 25, :2] = np.nan  # left knee
    points_px[2] = np.nan
    points_px[3, 33:] = 0.0
    contents, problems = array(tmp_path, points_px)
    assert not problems
    assert contents.forms == {"FreeMoCap"}
    joints = WHOLE_BODY if count > 33 else BODY_FEET
    found = dict(zip(joints.names, contents.frames[0][0, :, 0].tolist(), strict=True))
    assert (found["nose"], found["left_shoulder"], found["right_big_toe"]) == (0.0, 110.0, 320.0)
    if count > 33:
        assert (found["right_thumb_cmc"], found["left_thumb_cmc"]) == (340.0, 550.0)
    np.testing.assert_array_equal(contents.frames[0][0, 0], [0.0, 1.0, 1.0])
    assert contents.frames[1][0, joints.index("left_knee"), 2] == 0
    assert len(contents.frames[2]) == 0
    assert contents.frames[3].shape == (1, 21, 3)


@pytest.mark.parametrize(("third", "score"), [(None, 1.0), (np.nan, 1.0), (0.0, 1.0), (0.25, 0.25)])
def test_third_numbers_of_arrays(tmp_path: Path, third: float | None, score: float) -> None:
    """Scores of OpenPose, nothing of YOLO."""
    points_px = np.full((2, 17, 2 if third is None else 3), 7.0)
    if third is not None:
        points_px[..., 2] = third
    contents, problems = array(tmp_path, points_px)
    assert not problems
    np.testing.assert_array_equal(contents.frames[1][0], np.tile([7.0, 7.0, score], (17, 1)))


ENDLESS = (
    b"\x93NUMPY\x01\x00v\x00"
    + b"{'descr': '<f8', 'fortran_order': False, 'shape': (9000000000000, 17, 3), }".ljust(117)
    + b"\n"
)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (np.zeros((3, 5, 17, 3)), "holds 3 cameras"),
        (np.zeros((5, 17)), "The array is 5 x 17"),
        (np.array(1.0), "a number"),
        (np.zeros((5, 17, 4)), "5 x 17 x 4"),
        (np.zeros((5, 16, 3)), "16 points a frame"),
        (np.full((5, 17, 3), 20.0), "a score from 0 to 1"),
        (np.full((5, 17, 2), 1e9), "not within"),
        (np.array([{"a": 1}, None]), "not an array of numbers"),
        (np.array(["text"]), "not an array of numbers"),
        (np.zeros((5, 17, 3), dtype=[("x", "f8")]), "not an array of numbers"),
        (np.zeros((5, 17, 3), dtype=np.complex128), "not an array of numbers"),
        (b"", "not an array of numbers"),
        (b"PK\x03\x04", "not an array of numbers"),
        (b"\x80\x04N.", "not an array of numbers"),
        (b"\x93NUMPY\x01\x00", "not an array of numbers"),
        (ENDLESS, "not an array of numbers"),
        (ENDLESS.replace(b"{'descr'", b"-" * 8), "not an array of numbers"),
    ],
    ids=map(str, range(17)),
)  # fmt: skip
def test_wrong_arrays(tmp_path: Path, content: np.ndarray | bytes, words: str) -> None:
    _, problems = array(tmp_path, content)
    assert problems[0].code == "keypoints_unreadable"
    assert words in problems[0].message


def test_pickle_in_array_is_not_run(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "run",)

    _, problems = array(tmp_path, np.array([Trap()], dtype=object))
    assert "not an array of numbers" in problems[0].message
    assert not (tmp_path / "run").exists()


def test_file_of_all_cameras_of_freemocap(tmp_path: Path, simulation: Simulation) -> None:
    write_session(simulation, "YOLO", tmp_path)
    folder = tmp_path / "raw_data"
    folder.mkdir()
    content = freemocap_array(simulation)
    np.save(folder / "yolo_2dData_numCams_numFrames_numTrackedPoints_pixelXY.npy", content)
    np.save(folder / "yolo_3dData_numFrames_numTrackedPoints_reprojectionError.npy", content[0, ..., 0])
    files = folder, tmp_path / "calibration.json", tmp_path / "timestamps.csv"
    with pytest.raises(InputError) as raised:
        open_keypoints(*files)
    (problem,) = raised.value.problems
    assert problem.code == "pairing_unknown"
    assert "part1, part2" in str(problem.hint)
    assert "--pair-by-order" in str(problem.hint)
    session = open_keypoints(*files, pair_by_order=True)
    assert session.folders == {
        name: f"part{k + 1}" for k, name in enumerate(sorted(camera.name for camera in simulation.cameras))
    }
    for place, name in enumerate(session.folders):
        detections = session.detections[name]
        seen = content[place][np.isfinite(content[place]).all(-1).any(-1)]
        expected = np.where(np.isfinite(seen).all(-1, keepdims=True) & (seen[..., 2:] > 0), seen, np.nan)
        np.testing.assert_allclose(detections.keypoints_px, expected[..., :2], atol=1e-9)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (np.zeros((5, 17, 3)), "axes cameras"),
        (np.zeros((1001, 1, 17, 3)), "1,001 cameras"),
        (np.array([{}]), "not an array of numbers"),
    ],
    ids=map(str, range(3)),
)
def test_wrong_files_of_all_cameras(tmp_path: Path, content: np.ndarray, words: str) -> None:
    np.save(tmp_path / "points.npy", content, allow_pickle=True)
    problems: list[Problem] = []
    assert camera_folders(tmp_path, [], problems) == {}
    (problem,) = problems
    assert problem.code == "keypoints_unreadable"
    assert words in problem.message
