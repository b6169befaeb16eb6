"""Layouts of points that files do not name are told by the people, chosen, or asked for."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.calibration.write import encode
from pipeline.capture.keypoint_files.writing import encode_frame
from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.capture.preflight_npz import decode_keypoints
from pipeline.core.data.detections import Detections
from pipeline.core.errors import InputError
from pipeline.core.joints import BODY_25, BODY_FEET, COCO_17, COCO_18, SIDES, WHOLE_BODY, finger_joints
from pipeline.core.layouts import FILE_LAYOUTS
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.capture.keypoint_scenes import messages
from tests.records import encode_record

RATE_HZ = 25.0
# Points that are no joints, by their places: shares of the way from the middle of a part to the middle of another one.
_MIDDLES: Mapping[str, Mapping[int, tuple[str, str, float]]] = {
    "body-25b": {17: ("shoulder", "hip", -0.05), 18: ("shoulder", "hip", -0.55)},
    "human36m-17": {
        0: ("hip", "knee", 0.0),
        7: ("hip", "shoulder", 0.5),
        8: ("shoulder", "hip", -0.1),
        9: ("shoulder", "hip", -0.35),
        10: ("shoulder", "hip", -0.6),
    },
}


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=0.2), 5, 4, "whole")


def read_points(simulation: Simulation, detections: Detections, layout: str) -> np.ndarray:
    """People of a camera in the order of a layout: x, y and score, 0 for points that are not found."""
    found = np.nan_to_num(np.concatenate([detections.keypoints_px, detections.score[..., None]], axis=-1))
    by_name = dict(zip(simulation.joints.names, found.swapaxes(0, 1), strict=True))

    def middle(part: str) -> np.ndarray:
        left, right = (by_name[f"{side}_{part}"] for side in SIDES)
        return np.where((left[:, 2:] > 0) & (right[:, 2:] > 0), (left + right) / 2, 0.0)

    by_name |= {"neck": middle("shoulder"), "mid_hip": middle("hip")}
    people = np.zeros((len(found), len(FILE_LAYOUTS[layout].points), 3))
    for place, name in enumerate(FILE_LAYOUTS[layout].points):
        if name in by_name:
            people[:, place] = by_name[name]
    for place, (first, second, share) in _MIDDLES.get(layout, {}).items():
        start, end = middle(first), middle(second)
        is_seen = (start[:, 2] > 0) & (end[:, 2] > 0)
        people[is_seen, place] = (start + share * (end - start))[is_seen]
        people[is_seen, place, 2] = 0.9
    return people


def hidden(people: np.ndarray, layout: str, *parts: str) -> np.ndarray:
    """People without the points of joints whose names have some words."""
    places = [k for k, name in enumerate(FILE_LAYOUTS[layout].points) if name and any(part in name for part in parts)]
    people = people.copy()
    people[:, places] = 0.0
    return people


def openpose(people: np.ndarray) -> bytes:
    return json.dumps({"people": [{"pose_keypoints_2d": person.ravel().tolist()} for person in people]}).encode()


def opened(
    simulation: Simulation,
    folder: Path,
    layout: str,
    *hide: str,
    num_frames: int | None = None,
    num_cameras: int = 4,
    num_people: int = 9,
    write: Callable[[np.ndarray], bytes] = openpose,
    stated: str | None = None,
) -> KeypointSession:
    cameras = simulation.cameras[:num_cameras]
    for camera in cameras:
        detections = simulation.detections[camera.name]
        people = hidden(read_points(simulation, detections, layout), layout, *hide)
        is_one = simulation.identities[camera.name] < num_people
        (folder / "keypoints" / camera.name).mkdir(parents=True)
        for frame in range(num_frames or simulation.timebase.num_frames):
            path = folder / "keypoints" / camera.name / f"frame_{frame:012d}_keypoints.json"
            path.write_bytes(write(people[is_one & (detections.frame == frame)]))
    rig = folder / "rig.json"
    rig.write_bytes(encode(cameras))
    return open_keypoints(folder / "keypoints", rig, frame_rate_hz=RATE_HZ, layout=stated)


def assert_joints(session: KeypointSession, simulation: Simulation, *hide: str) -> None:
    """Joints of a session are where the simulation has them."""
    names = [
        name for name in session.joints.names if name in simulation.joints.names and not any(h in name for h in hide)
    ]
    num_seen = 0
    for camera, detections in session.detections.items():
        sent = simulation.detections[camera]
        joints_px = detections.keypoints_px[:, session.joints.indices(tuple(names))]
        sent_px = sent.keypoints_px[np.isin(sent.frame, detections.frame)][:, simulation.joints.indices(tuple(names))]
        is_body = np.isfinite(joints_px).any((0, 2))
        np.testing.assert_allclose(joints_px[:, is_body], sent_px[:, is_body], atol=1e-6)
        num_seen += int(is_body.sum())
    assert num_seen >= 6 * len(session.detections)


HIDDEN = [(), ("eye",), ("left_eye",), ("eye", "ear", "nose"), ("left_wrist",), ("right_elbow",), ("hip",), ("knee",)]


@pytest.mark.parametrize("hide", HIDDEN, ids=" ".join)
@pytest.mark.parametrize(
    ("layout", "joints"),
    [
        ("body-25", BODY_25),
        ("body-25b", BODY_FEET),
        ("coco-17", COCO_17),
        ("human36m-17", COCO_17),
        ("coco-18", COCO_18),
        ("trt-pose-18", COCO_18),
    ],
)
def test_layout_with_points_never_seen_is_told_by_people(
    room: Simulation, tmp_path: Path, layout: str, joints: object, hide: tuple[str, ...]
) -> None:
    session = opened(room, tmp_path, layout, *hide)
    assert session.layout is not None
    assert (session.layout.name, session.joints) == (layout, joints)
    assert session.layout.told_by in ("pictures", "world")
    assert_joints(session, room, *hide)


@pytest.mark.parametrize("layout", ["body-25", "body-25b", "coco-17", "human36m-17"])
def test_layout_of_person_in_one_picture_of_four_cameras_is_told(room: Simulation, tmp_path: Path, layout: str) -> None:
    session = opened(room, tmp_path, layout, "eye", num_frames=1, num_people=1)
    assert session.layout is not None
    assert session.layout.name == layout
    assert session.layout.num_people <= 6


def test_body_25b_with_hands_has_body_and_hands(room: Simulation, tmp_path: Path) -> None:
    rows = {side: np.array(room.joints.indices((f"{side}_wrist", *finger_joints(side)))) for side in SIDES}

    def write(people: np.ndarray) -> bytes:
        # The hands of all people are those of the first detection of the room: only their place counts.
        detections = next(iter(room.detections.values()))
        hands = np.nan_to_num(np.concatenate([detections.keypoints_px[0], np.ones((len(room.joints.names), 1))], -1))
        sides = {f"hand_{side}_keypoints_2d": hands[rows[side]].ravel().tolist() for side in SIDES}
        return json.dumps(
            {"people": [{"pose_keypoints_2d": person.ravel().tolist(), **sides} for person in people]}
        ).encode()

    session = opened(room, tmp_path, "body-25b", "eye", write=write)
    assert session.joints == WHOLE_BODY
    body = replace(session, joints=BODY_FEET, detections={
        name: replace(found, keypoints_px=found.keypoints_px[:, : len(BODY_FEET.names)])
        for name, found in session.detections.items()
    })  # fmt: skip
    assert_joints(body, room, "eye")
    finger = session.joints.index("left_thumb_tip")
    expected = next(iter(room.detections.values())).keypoints_px[0, room.joints.index("left_thumb_tip")]
    for detections in session.detections.values():
        np.testing.assert_allclose(
            detections.keypoints_px[:, finger], np.broadcast_to(expected, (len(detections.frame), 2))
        )


def test_coco_results_in_order_of_human36m_are_told(room: Simulation, tmp_path: Path) -> None:
    def write(people: np.ndarray) -> bytes:
        return json.dumps([{"category_id": 1, "keypoints": person.ravel().tolist()} for person in people]).encode()

    session = opened(room, tmp_path, "human36m-17", write=write)
    assert session.layout is not None
    assert session.layout.name == "human36m-17"
    assert_joints(session, room)


def test_coco_annotations_that_name_their_points_keep_them(room: Simulation, tmp_path: Path) -> None:
    """Even people whose lengths fit another layout."""

    def write(people: np.ndarray) -> bytes:
        listed = [{"category_id": 1, "keypoints": person.ravel().tolist()} for person in people]
        categories = [{"id": 1, "name": "person", "keypoints": list(COCO_17.names)}]
        return json.dumps({"annotations": listed, "categories": categories}).encode()

    session = opened(room, tmp_path, "human36m-17", write=write, stated="human36m-17")
    assert session.layout is None
    camera = room.cameras[0].name
    spine_px = read_points(room, room.detections[camera], "human36m-17")[:, 0, :2]
    is_seen = spine_px.any(1)
    nose_px = session.detections[camera].keypoints_px[:, session.joints.index("nose")]
    np.testing.assert_allclose(nose_px[is_seen], spine_px[is_seen])
    assert any("human36m-17 is not used" in warning for warning in messages(session))


@pytest.mark.parametrize("layout", ["coco-17", "body-25b", "human36m-17"])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_wrong_points_of_low_scores_do_not_hide_layout(
    room: Simulation, tmp_path: Path, layout: str, scale: float
) -> None:
    generator = np.random.default_rng(2)

    def write(people: np.ndarray) -> bytes:
        people = people.copy()
        is_wrong = (people[..., 2] > 0) & (generator.random(people.shape[:2]) < 0.2)
        people[is_wrong, :2] += generator.normal(0.0, 150.0, (is_wrong.sum(), 2))
        people[is_wrong, 2] = 0.08
        people[..., 2] *= scale
        return openpose(people)

    session = opened(room, tmp_path, layout, write=write)
    assert session.layout is not None
    assert session.layout.name == layout


def test_points_of_random_places_ask_for_layout(room: Simulation, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)

    def write(people: np.ndarray) -> bytes:
        return openpose(np.concatenate([rng.uniform(100, 900, (*people.shape[:2], 2)), people[..., 2:] + 0.1], -1))

    with pytest.raises(InputError) as caught:
        opened(room, tmp_path, "body-25", write=write)
    (problem,) = caught.value.problems
    assert (problem.code, problem.field) == ("keypoints_layout", "layout")
    assert "body-25 or body-25b" in problem.message
    assert "--layout" in str(problem.hint)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "rig.json", frame_rate_hz=RATE_HZ, layout="body-25")
    assert session.layout is not None
    assert (session.layout.name, session.layout.told_by) == ("body-25", "choice")


def test_points_alike_in_all_layouts_are_read_without_question(room: Simulation, tmp_path: Path) -> None:
    session = opened(room, tmp_path, "body-25b", *(name for name in BODY_FEET.names if name != "nose"),
                     write=lambda people: openpose(np.where(np.arange(25)[:, None] > 0, 0.0, people)))  # fmt: skip
    assert session.layout is not None
    assert session.layout.told_by == "points"


def test_stated_layout_is_taken_and_doubted(room: Simulation, tmp_path: Path) -> None:
    session = opened(room, tmp_path, "body-25b", "eye", stated="body-25")
    assert session.layout is not None
    assert (session.joints, session.layout.told_by) == (BODY_25, "choice")
    (doubt,) = [finding for finding in session.findings if finding.code == "keypoints_form"]
    assert (doubt.severity, doubt.evidence) == ("warning", {"layout": "body-25", "fits": "body-25b"})


def test_stated_layout_that_fits_is_not_doubted(room: Simulation, tmp_path: Path) -> None:
    session = opened(room, tmp_path, "body-25b", stated="body-25b")
    assert session.findings == ()
    assert_joints(session, room)


@pytest.mark.parametrize("layout", ["coco-17", "halpe-26"])
def test_stated_layout_of_another_number_of_points_is_refused(room: Simulation, tmp_path: Path, layout: str) -> None:
    with pytest.raises(InputError) as caught:
        opened(room, tmp_path, "body-25", stated=layout)
    (problem,) = caught.value.problems
    assert (problem.code, problem.field) == ("keypoints_layout", "layout")
    assert f"{layout} was stated, which has {layout[-2:]} points; people have 25" in problem.message
    assert "body-25 or body-25b" in str(problem.hint)


def test_unknown_layout_is_refused_with_known_names(room: Simulation, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        opened(room, tmp_path, "body-25", stated="body25")
    (problem,) = caught.value.problems
    assert problem.code == "keypoints_layout"
    assert "body-25b, " in str(problem.hint)


def test_people_of_body_25_need_no_finding(room: Simulation, tmp_path: Path) -> None:
    def write(people: np.ndarray) -> bytes:
        return encode_frame(np.where(people[..., 2:] > 0, people[..., :2], np.nan), people[..., 2], BODY_25)

    session = opened(room, tmp_path, "body-25", write=write)
    assert session.findings == ()
    assert session.layout is not None
    assert session.layout.told_by == "pictures"


def test_layout_with_one_of_its_number_is_told_by_number(room: Simulation, tmp_path: Path) -> None:
    session = opened(room, tmp_path, "halpe-26")
    assert session.layout is not None
    assert (session.layout.name, session.layout.told_by) == ("halpe-26", "number")


def test_camera_without_people_has_joints_of_others(room: Simulation, tmp_path: Path) -> None:
    emptied = replace(room, detections={
        name: replace(found, score=found.score * (name != room.cameras[0].name))
        for name, found in room.detections.items()
    })  # fmt: skip
    session = opened(emptied, tmp_path, "body-25b")
    assert session.joints == BODY_FEET
    assert not len(session.detections[room.cameras[0].name].frame)


def test_layout_of_session_is_kept_in_its_record(room: Simulation, tmp_path: Path) -> None:
    session = opened(room, tmp_path, "body-25b", num_frames=1)
    assert session.layout is not None
    assert decode_keypoints(encode_record(session)).layout == session.layout
