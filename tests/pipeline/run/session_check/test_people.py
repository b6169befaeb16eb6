"""Faults of a rig are found by the people of simulated scenes, and named; good rigs have none."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.core.data.cameras import Camera
from pipeline.core.findings import Finding
from pipeline.run.session_check.explain import MOVES, Move, move_points
from pipeline.run.session_check.people import check_people
from pipeline.run.session_check.sightings import SimultaneousPeople, choose_instants, collect_sightings, frames_at
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.run.session_check.rigs import bumped, in_other_world, posed, seen_by, sightings

SCENE = record(replace(find_scene("room"), duration_s=8.0), seed=3)
CAMERAS, SEEN = SCENE.cameras, sightings(SCENE)
NUM = len(CAMERAS)


def checked(cameras: Sequence[Camera] = CAMERAS, seen: SimultaneousPeople = SEEN) -> Sequence[Finding]:
    return check_people(cameras, seen).findings


def found(cameras: Sequence[Camera] = CAMERAS, seen: SimultaneousPeople = SEEN) -> list[tuple[str, str | None]]:
    return [(finding.code, finding.camera) for finding in checked(cameras, seen)]


def levels(findings: Sequence[Finding]) -> list[tuple[str, str]]:
    return [(finding.code, finding.severity) for finding in findings]


def exchanged(order: Sequence[int]) -> tuple[Camera, ...]:
    return tuple(replace(CAMERAS[place], name=camera.name) for place, camera in zip(order, CAMERAS, strict=True))


def slow(*values: object) -> Any:
    """Parameters of a test that only the slow suite runs."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("scene", "seed"),
    [
        *(("room", 1), ("comings-and-goings", 3), ("noisy", 2)),
        *(
            slow(scene, 4)
            for scene in ("store", "outdoor", "exchange", "contact", "sports", "unsynchronised", "crowd-3")
        ),
    ],
)
def test_good_rigs_have_no_finding_and_their_pairs_no_error(scene: str, seed: int) -> None:
    simulation = record(replace(find_scene(scene), duration_s=6.0), seed)
    cameras, seen = simulation.cameras, sightings(simulation)
    assert found(cameras, seen) == []
    for pair in itertools.combinations(range(0, len(cameras), max(1, len(cameras) // 4)), 2):
        of_pair = replace(seen, points_px=tuple(seen.points_px[number] for number in pair))
        findings = checked([cameras[number] for number in pair], of_pair)
        assert {finding.severity for finding in findings} <= {"warning"}, (pair, findings)


def test_exchanged_cameras_are_named_with_each_other() -> None:
    order = [1, 0, *range(2, NUM)]
    one, other = checked(exchanged(order), SEEN)
    assert (one.code, one.camera, one.evidence["other_camera"]) == (
        "cameras_exchanged",
        CAMERAS[0].name,
        CAMERAS[1].name,
    )
    assert (other.camera, other.evidence["other_camera"]) == (CAMERAS[1].name, CAMERAS[0].name)
    assert one.severity == "error"
    assert one.evidence["disagreement_mended"] < 0.5 * one.evidence["disagreement"]


def test_all_cameras_in_another_order() -> None:
    order = [*range(1, NUM), 0]
    named = {finding.camera: finding.evidence["other_camera"] for finding in checked(exchanged(order), SEEN)}
    # Camera k has the calibration of its follower, so its picture fits what its predecessor was given.
    assert named == {CAMERAS[number].name: CAMERAS[number - 1].name for number in range(NUM)}


@pytest.mark.parametrize("move", ["90", slow("180"), slow("270"), "mirrored"])
def test_turned_or_mirrored_picture(move: Move) -> None:
    moved = SEEN.moved(2, lambda points: move_points(points, move, CAMERAS[2].size_px, SEEN.joints))
    (finding,) = checked(CAMERAS, moved)
    assert finding.camera == CAMERAS[2].name
    if move == "mirrored":
        assert finding.code == "picture_mirrored"
    else:
        assert finding.code == "picture_turned"
        # The picture was turned by the rest of a whole turn.
        assert finding.evidence["turn_deg"] == (360 - int(move)) % 360


@pytest.mark.parametrize("cameras", [(2,), range(NUM)])
def test_check_people_exchanged_coordinates_are_named(cameras: Sequence[int]) -> None:
    moved = SEEN
    for camera in cameras:
        moved = moved.moved(camera, lambda points: points[..., ::-1])
    expected = [("coordinates_exchanged", CAMERAS[camera].name) for camera in cameras]
    findings = checked(CAMERAS, moved)
    assert [(finding.code, finding.camera) for finding in findings] == expected
    assert {finding.severity for finding in findings} == {"error"}


@pytest.mark.parametrize("move", MOVES)
def test_moving_points_back_is_inverse(move: Move) -> None:
    points = np.arange(2.0 * 17 * 3).reshape(3, 17, 2)
    back: dict[Move, Move] = {"90": "270", "180": "180", "270": "90", "mirrored": "mirrored"}
    again = move_points(move_points(points, move, (640, 480), SEEN.joints), back[move], (640, 480), SEEN.joints)
    np.testing.assert_allclose(again, points)


@pytest.mark.parametrize("degrees", [slow(3.0), 10.0, slow(60.0)])
def test_moved_camera_is_only_one_that_is_named(degrees: float) -> None:
    cameras = (*CAMERAS[:1], bumped(CAMERAS[1], degrees), *CAMERAS[2:])
    assert found(cameras) == [("camera_disagrees", CAMERAS[1].name)]


def test_calibration_of_another_rig() -> None:
    turns = np.random.default_rng(5).uniform(0.0, 360.0, NUM)
    cameras = [bumped(camera, turn) for camera, turn in zip(CAMERAS, turns, strict=True)]
    assert found(cameras) == [("calibration_of_another_rig", None)]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda camera: in_other_world(camera, scale=1000.0), "stature_out_of_range"),
        slow(lambda camera: in_other_world(camera, scale=0.01), "stature_out_of_range"),
        (lambda camera: in_other_world(camera, Rotation.from_euler("x", 180, degrees=True)), "upside_down"),
        (lambda camera: in_other_world(camera, Rotation.from_euler("x", 90, degrees=True)), "not_upright"),
        (lambda camera: in_other_world(camera, lift_m=1.5), "floor_not_at_zero"),
    ],
)
def test_wrong_world_is_one_finding(change: Callable[[Camera], Camera], expected: str) -> None:
    (finding,) = checked([change(camera) for camera in CAMERAS])
    severity = "warning" if expected == "floor_not_at_zero" else "error"
    assert (finding.code, finding.camera, finding.severity) == (expected, None, severity)


def test_unit_is_guessed_and_height_measured() -> None:
    (unit,) = checked([in_other_world(camera, scale=1000.0) for camera in CAMERAS], SEEN)
    assert unit.hint is not None
    assert "mm" in unit.hint
    assert 1300 < unit.evidence["stature_m"] < 2000
    (floor,) = checked([in_other_world(camera, lift_m=1.5) for camera in CAMERAS], SEEN)
    assert floor.evidence["height_m"] == pytest.approx(1.5, abs=0.1)


def test_mirrored_world() -> None:
    """Left and right of everybody are exchanged, as in a capture whose videos and board are mirrored."""
    names = SEEN.joints.names
    other = [names.index(_other(name)) for name in names]
    mirrored = SEEN
    for camera in range(NUM):
        mirrored = mirrored.moved(camera, lambda points: points[:, other])
    assert found(seen=mirrored) == [("mirrored_world", None)]


def _other(name: str) -> str:
    pairs = {"left": "right", "right": "left"}
    side, _, rest = name.partition("_")
    return f"{pairs[side]}_{rest}" if side in pairs else name


def test_one_video_twice() -> None:
    twice = replace(SEEN, points_px=(SEEN.points_px[0], SEEN.points_px[0], *SEEN.points_px[2:]))
    assert found(seen=twice) == [("same_video", CAMERAS[1].name)]


def without(*cameras: int) -> SimultaneousPeople:
    seen = SEEN
    for camera in cameras:
        seen = seen.moved(camera, lambda points: points[:0])
    return seen


def test_nobody() -> None:
    (nobody,) = checked(CAMERAS, without(*range(NUM)))
    # A place may be empty: an empty result is right then.
    assert (nobody.code, nobody.severity) == ("nobody_detected", "warning")
    assert set(nobody.evidence["people"].values()) == {0}
    (alone,) = checked(CAMERAS, without(*range(1, NUM)))
    assert alone.code == "nobody_detected"
    assert CAMERAS[0].name in alone.message
    assert found(seen=without(1)) == [("camera_sees_nobody", CAMERAS[1].name)]


def test_camera_that_sees_people_at_other_instants() -> None:
    halves = [tuple(one[:0] if k % 2 else one for k, one in enumerate(of) if one is not None) for of in SEEN.points_px]
    late = tuple(one[:0] if not k % 2 else one for k, one in enumerate(SEEN.points_px[0]) if one is not None)
    seen = replace(SEEN, points_px=(late, *halves[1:]))
    (finding,) = checked(seen=seen)
    # Other instants than the twelve may tell otherwise.
    assert (finding.code, finding.camera, finding.severity) == ("no_common_people", CAMERAS[0].name, "warning")


def test_instants_are_in_middle_of_recorded_parts() -> None:
    assert choose_instants([range(0, 8)], 4) == [1, 3, 5, 7]
    assert choose_instants([range(0, 4), range(100, 104)], 4) == [1, 3, 101, 103]
    assert choose_instants([range(5, 7)], 12) == [5, 6]
    assert choose_instants([], 12) == []


def test_camera_has_no_frame_before_it_starts() -> None:
    simulation: Simulation = SCENE
    times = next(iter(simulation.times.values()))
    late = replace(times, time_s=times.time_s + 4.0)
    frames = frames_at(late, simulation.timebase, [0, round(4.0 * simulation.timebase.frame_rate_hz) + 3])
    assert frames[0] is None
    assert frames[1] == 3
    people = collect_sightings(
        CAMERAS, simulation.detections, {camera.name: [None] for camera in CAMERAS}, simulation.joints, [0.0]
    )
    assert people.points_px[0] == (None,)


def test_findings_survive_their_json() -> None:
    (finding,) = checked(CAMERAS, without(*range(1, NUM)))
    assert Finding.from_json(finding.to_json()) == finding


@pytest.mark.parametrize(
    "turn",
    [
        Rotation.from_euler("xz", [-90, 40], degrees=True),  # on the back
        Rotation.from_euler("xz", [100, 200], degrees=True),  # on hands and knees, and face down
        Rotation.from_euler("y", 88, degrees=True),  # on the side
    ],
    ids=["supine", "prone", "side"],
)
def test_people_who_lie_are_no_error_before_upright_cameras(turn: Rotation) -> None:
    people_m = posed(SCENE, turn)[:, :1]
    (finding,) = checked(seen=seen_by(CAMERAS, [people_m] * NUM, SCENE.joints))
    assert (finding.code, finding.severity) == ("not_upright", "warning")
    assert "lie or crawl" in finding.message
    # The same people, and cameras that are tilted as they are: the world is.
    tilted = [in_other_world(camera, Rotation.from_euler("x", 90, degrees=True)) for camera in CAMERAS]
    assert levels(checked(tilted)) == [("not_upright", "error")]


def test_people_on_their_hands_are_no_error() -> None:
    people_m = posed(SCENE, Rotation.from_euler("x", 180, degrees=True), height_m=0.9)
    (finding,) = checked(seen=seen_by(CAMERAS, [people_m] * NUM, SCENE.joints))
    assert (finding.code, finding.severity) == ("not_upright", "warning")
    assert "upside down" in finding.message


def test_small_child_is_no_error_and_another_unit_is() -> None:
    child_m = posed(SCENE, Rotation.identity(), scale=0.5, height_m=0.45)
    (finding,) = checked(seen=seen_by(CAMERAS, [child_m] * NUM, SCENE.joints, noise_px=1.0))
    assert (finding.code, finding.severity) == ("stature_out_of_range", "warning")
    feet = [in_other_world(camera, scale=3.28) for camera in CAMERAS]
    assert levels(checked(feet)) == [("stature_out_of_range", "error")]


def test_cameras_that_see_different_people_too_are_no_error() -> None:
    """Two cameras see one person together, and one each that the other one does not see."""
    people_m = posed(SCENE, Rotation.identity(), height_m=0.9)
    own_m = [people_m[:, [0, 1]], people_m[:, [0, 2]]]
    pair = CAMERAS[:2]
    (finding,) = checked(pair, seen_by(pair, own_m, SCENE.joints))
    assert (finding.code, finding.severity) == ("calibration_of_another_rig", "warning")
    # Of another rig nobody fits.
    other = (pair[0], bumped(pair[1], 40.0))
    assert levels(checked(other, seen_by(pair, own_m, SCENE.joints))) == [("calibration_of_another_rig", "error")]


def test_cameras_that_see_few_people_together_are_no_error() -> None:
    """Two cameras see one person together, and three each whom the other one misses: a quarter of the pairs agrees."""
    crowd_m = np.concatenate(
        [posed(SCENE, Rotation.from_euler("z", 40.0 * turn, degrees=True), height_m=0.9) for turn in range(3)], axis=1
    )
    common_m, left_m, right_m = crowd_m[:, :1], crowd_m[:, 1:4] + [0.5, 0.3, 0.0], crowd_m[::-1, 4:7] - [0.4, 0.6, 0.0]
    pair = CAMERAS[:2]
    seen = seen_by(pair, [np.concatenate([common_m, own_m], axis=1) for own_m in (left_m, right_m)], SCENE.joints)
    assert levels(checked(pair, seen)) == [("calibration_of_another_rig", "warning")]
    other = (pair[0], bumped(pair[1], 40.0))
    assert levels(checked(other, seen)) == [("calibration_of_another_rig", "error")]


def test_few_bodies_are_no_error() -> None:
    """Two false bodies that agree with nothing, as detectors find them in empty rooms."""
    few = tuple(
        tuple(one if k < 2 else one[:0] for k, one in enumerate(of) if one is not None) for of in SEEN.points_px
    )
    single = replace(SEEN, points_px=tuple(tuple(points[:1] for points in of) for of in few))
    turned = [bumped(camera, 70.0 * number) for number, camera in enumerate(CAMERAS)]
    assert {finding.severity for finding in checked(turned, single)} <= {"warning"}


@pytest.mark.parametrize(
    ("cameras", "move"),
    [
        (exchanged([1, 0, *range(2, NUM)]), None),
        (CAMERAS, "mirrored"),
        (CAMERAS, "90"),
        ([bumped(camera, 70.0 * number) for number, camera in enumerate(CAMERAS)], None),
        ([CAMERAS[0], bumped(CAMERAS[1], 30.0), *CAMERAS[2:]], None),
        ([in_other_world(camera, scale=100.0) for camera in CAMERAS], None),
        ([in_other_world(camera, Rotation.from_euler("x", 180, degrees=True)) for camera in CAMERAS], None),
    ],
    ids=["exchanged", "mirrored", "turned", "another rig", "bumped", "unit", "upside down"],
)
def test_instants_that_follow_each_other_at_once_are_no_error(cameras: Sequence[Camera], move: Move | None) -> None:
    """Errors of a detector in one frame are those of the next frame, too."""
    seen = (
        SEEN
        if move is None
        else SEEN.moved(1, lambda points: move_points(points, move, CAMERAS[1].size_px, SEEN.joints))
    )
    short = replace(seen, time_s=tuple(0.04 * instant for instant in range(len(seen.time_s))))
    expected = levels(checked(cameras, seen))
    assert {severity for _, severity in expected} == {"error"}
    # 12 frames at 25 Hz have two instants that are a quarter of a second apart.
    assert levels(checked(cameras, short)) == [(code, "warning") for code, _ in expected]


def test_picture_of_person_has_no_left_and_right() -> None:
    """The nose of a cut-out is 5 mm behind the ears by the errors of the calibration, that of a person 10 cm before."""
    sides = {"ear": (0.08, 1.65), "eye": (0.03, 1.66), "shoulder": (0.19, 1.45), "elbow": (0.25, 1.15)}
    sides |= {"wrist": (0.27, 0.9), "hip": (0.14, 0.95), "knee": (0.13, 0.5), "ankle": (0.13, 0.1)}
    places_m = {"nose": (0.0, 1.62)}
    for part, (side_m, height_m) in sides.items():
        places_m |= {f"left_{part}": (side_m, height_m), f"right_{part}": (-side_m, height_m)}

    def codes(nose_m: float, sign: float = 1.0) -> set[str]:
        person_m = [
            (nose_m if name == "nose" else 0.0, sign * places_m[name][0], places_m[name][1])
            for name in SCENE.joints.names
        ]
        people_m = np.broadcast_to(np.array(person_m), (12, 1, len(person_m), 3))
        return {
            finding.code for finding in checked(seen=seen_by(CAMERAS, [people_m] * NUM, SCENE.joints, noise_px=0.1))
        }

    assert "mirrored_world" not in codes(-0.005)
    assert "mirrored_world" not in codes(0.1)
    assert "mirrored_world" in codes(0.1, sign=-1.0)


@pytest.fixture(scope="module")
def eleven() -> tuple[list[Camera], SimultaneousPeople]:
    """Eleven cameras, cam1 to cam11, and what they see."""
    scene = replace(find_scene("walk"), rig=replace(find_scene("walk").rig, num_cameras=11), duration_s=6.0)
    simulation = record(scene, seed=6)
    names = (f"cam{number}" for number in range(1, 12))
    cameras = [replace(camera, name=name) for camera, name in zip(simulation.cameras, names, strict=True)]
    seen = sightings(simulation)
    assert found(cameras, seen) == []
    return cameras, seen


@pytest.mark.parametrize("is_backward", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_eleven_cameras_in_alphabetical_for_natural_order(
    is_backward: bool, eleven: tuple[list[Camera], SimultaneousPeople]
) -> None:
    cameras, seen = eleven
    names = [camera.name for camera in cameras]
    places = dict(zip(names, sorted(names), strict=True))
    if is_backward:
        places = {place: name for name, place in places.items()}
    # The picture of camera ``name`` was filmed by the camera ``places[name]``.
    mixed = replace(seen, points_px=tuple(seen.points_px[names.index(places[name])] for name in names))
    findings = checked(cameras, mixed)
    exchanged_by_name = {finding.camera: finding.evidence["other_camera"] for finding in findings}
    assert exchanged_by_name == {name: place for name, place in places.items() if name != place}
    assert {finding.severity for finding in findings} == {"error"}
