"""Files about own points: rigid objects and bones are read, and all problems of a file are told at once."""

import contextlib
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.own_points_file import with_own_points
from pipeline.capture.preflight_npz import decode_keypoints
from pipeline.core.errors import InputError
from pipeline.core.joints import COCO_17
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.capture.point_files.mutations import mutated
from tests.pipeline.own_point_scenes import BOX, RACKET
from tests.records import encode_record

BOX_M = {(a, b): float(np.linalg.norm(np.subtract(BOX[a], BOX[b]))) for a, b in itertools.combinations(BOX, 2)}
WHOLE = f"""
objects:
  racket:
    points:
      tip: [0, 0, 0.5]  # from the grip
      "left": [-0.12, 0, 0.35]
      right: [0.12, 0, 0.35]
      grip: [0, 0, 0]
  My box:
    distances: {[[*pair, round(length_m, 3)] for pair, length_m in BOX_M.items()]}
bones: [[tip, grip], [box_a, box_b]]
"""


@pytest.fixture(scope="module")
def session() -> KeypointSession:
    cameras = record(find_scene("room"), seed=1, num_views=2).cameras
    names = (*COCO_17.names, *RACKET, *BOX, "Schläger")
    points_px = {camera.name: np.full((3, 1, len(names), 2), 50.0) for camera in cameras}
    return from_arrays(points_px, None, cameras, frame_rate_hz=25.0, joints=names)


def read(session: KeypointSession, content: str | bytes, tmp_path: Path, name: str = "own.yaml") -> KeypointSession:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return with_own_points(session, path)


def test_objects_and_bones_are_read_and_kept(session: KeypointSession, tmp_path: Path) -> None:
    found = read(session, WHOLE, tmp_path)
    for own in (found.own, decode_keypoints(encode_record(found)).own):
        racket, box = own.shapes
        assert (racket.name, racket.points, racket.has_sides) == ("racket", tuple(RACKET), True)
        np.testing.assert_array_equal(racket.xyz_m, list(RACKET.values()))
        assert (box.name, box.points, box.has_sides) == ("My_box", tuple(BOX), False)
        for (a, b), length_m in BOX_M.items():
            apart_m = np.linalg.norm(box.xyz_m[box.points.index(a)] - box.xyz_m[box.points.index(b)])
            assert apart_m == pytest.approx(length_m, abs=0.001)
        assert own.bones == (("tip", "grip"), ("box_a", "box_b"))
    assert found.findings[-1].message.startswith("own.yaml has racket of tip, left, right, grip; My_box of box_a")
    assert encode_record(found) != encode_record(session)


def test_json_and_names_with_accents_are_read(session: KeypointSession, tmp_path: Path) -> None:
    content = json.dumps({"bones": [["Schläger", "tip"]]}, ensure_ascii=False)
    assert read(session, content, tmp_path, "own.json").own.bones == (("Schlager", "tip"),)


def test_all_problems_are_told_at_once(session: KeypointSession, tmp_path: Path) -> None:
    content = """
    objects:
      a: {points: {tip: [0, 0, 0], racket: [0, 0, 1], left: [0, 0, 2]}}
      b: {distances: [[box_a, box_b, 1], [box_b, box_c, 1], [box_a, box_c, 5]]}
      c: {distances: [[grip, right, 1], [right, tip, 1]]}
      d: {points: {box_d: [0, 0, 0]}, distances: [[box_d, elbow, 1]]}
    bones: [[grip, grip], [hoof, tip]]
    """
    with pytest.raises(InputError) as caught:
        read(session, content, tmp_path)
    told = [f"{problem.field or ''}: {problem.message}" for problem in caught.value.problems]
    assert told == [
        ": The keypoint files have no points racket, elbow, hoof; points of your own are tip, left, right, grip, "
        "box_a, box_b, box_c, box_d and 1 more.",
        "objects: Points are named twice: box_d, tip.",
        "bones: Bones begin and end at one point: grip.",
        "objects.a: Of this object, the points are on one line, about which it can turn unseen: add a point beside it.",
        "objects.b: Of this object, the distances contradict each other, in metres: box_a to box_b is 1 (fits 2), "
        "box_a to box_c is 5 (fits 4), box_b to box_c is 1 (fits 2).",
        "objects.c: Of this object, several shapes have these distances; state grip to tip, too.",
        "objects.d: Of this object, either points or distances are to be stated.",
    ]
    assert {problem.code for problem in caught.value.problems} == {"own_points_invalid"}


@pytest.mark.parametrize(
    ("content", "field", "sentence"),
    [
        ("", None, "no objects and no bones"),
        ("- tip", None, "can't be read"),
        ("bones: &a [[tip, grip]]", None, "can't be read"),
        (b"\xff\x00\x01", None, "can't be read"),
        ("objects: [1]", "objects", "valid dictionary"),
        ("objects: {a: {points: {tip: [0, 0]}}}", "objects.a.points.tip.2", "required"),
        ("objects: {a: {points: {tip: [0, 0, .nan]}}}", "objects.a.points.tip.2", "finite number"),
        ("objects: {a: {points: {tip: [0, 0, 680]}}}", "objects.a.points.tip.2", "less than or equal to 100"),
        ("objects: {a: {distances: [[tip, grip, 0]]}}", "objects.a.distances.0.2", "greater than 0"),
        ("objects: {a: {places: 1}}", "objects.a.places", "not permitted"),
        ("bones: [[tip, 5]]", "bones.0.1", "valid string"),
        ("joints: [[tip, grip]]", "joints", "not permitted"),
        ("objects: {a: {distances: [[tip, grip, 1], [grip, tip, 1], [tip, left, 1]]}}", "objects.a", "stated twice"),
        ("objects: {a: {points: {tip: [0, 0, 0], grip: [0, 0, 1]}}}", "objects.a", "3 to 50 points are needed"),
    ],
)
def test_unusable_file_gets_sentence(
    session: KeypointSession, tmp_path: Path, content: str | bytes, field: str | None, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        read(session, content, tmp_path)
    assert caught.value.problems[0].field == field


def test_many_mistakes_give_fifty_problems(session: KeypointSession, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(session, f"objects: {{a: {{distances: [{','.join(2000 * ['[tip, grip, 0]'])}]}}}}", tmp_path)
    assert [problem.field for problem in caught.value.problems][-1] == "objects.a.distances.49.2"


def test_file_that_is_missing_or_beside_joints_alone_gets_sentence(session: KeypointSession, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        with_own_points(session, tmp_path / "none.yaml")
    points_px = {camera.name: np.full((3, 1, 17, 2), 50.0) for camera in session.cameras}
    bare = from_arrays(points_px, None, session.cameras, frame_rate_hz=25.0, joints=COCO_17.names)
    with pytest.raises(InputError, match="no points tip, grip; points of your own are none"):
        read(bare, "bones: [[tip, grip]]", tmp_path)


@pytest.mark.parametrize("number", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_mutated_files_are_read_or_refused(session: KeypointSession, tmp_path: Path, number: int) -> None:
    random, num_read = np.random.default_rng(4), 0
    for _ in range(number):
        content = mutated(WHOLE.encode(), random, b"0123456789.,-+e \t\n{}[]na:&*!'\"")
        with contextlib.suppress(InputError):  # any other exception fails the test
            read(session, content, tmp_path)
            num_read += 1
    assert num_read < number // 2
