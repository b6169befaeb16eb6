"""Parts of the calibration from people."""

import numpy as np
import pytest

from pipeline.calibration.people.following import JOINTS
from pipeline.calibration.people.pairs import relate_by_people, sampson
from pipeline.calibration.people.people_checks import people_warnings
from pipeline.calibration.people.people_world import PeopleWorld
from pipeline.calibration.people.stature import Statures, match_statures, others_at_once, scale_from, statures
from pipeline.calibration.people.tracklets import ViewTracklet, find_tracklets, shared_instants
from pipeline.calibration.report import CameraReport
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.data.detections import Detections
from pipeline.core.joints import JointSet
from pipeline.geometry.camera import project
from pipeline.validation.simulation.scenes import Simulation

SET = JointSet(JOINTS, ())


def walkers(simulation: Simulation, places_px: np.ndarray) -> Detections:
    """Bodies, each a square of joints of 100 px, at places of shape (frames, people, 2)."""
    num_frames, num_people = places_px.shape[:2]
    shape = np.random.default_rng(0).uniform(-50, 50, (len(JOINTS), 2))
    shape[0], shape[1] = (0, -50), (0, 50)
    points_px = (places_px[:, :, None] + shape).reshape(-1, len(JOINTS), 2)
    frame = np.repeat(np.arange(num_frames), num_people)
    box_px = np.concatenate([points_px.min(1), points_px.max(1)], axis=1)
    return Detections(simulation.cameras[0].name, frame, points_px, np.ones(points_px.shape[:2]), box_px)


def test_tracklet_ends_where_two_people_may_be_exchanged(walk: Simulation) -> None:
    camera = walk.cameras[0]
    along, height = np.linspace(100.0, 900.0, 250), np.full(250, 300.0)
    crossing = np.stack([np.column_stack([along, height]), np.column_stack([along[::-1], height + 10.0])], axis=1)
    times = {camera.name: FrameTimes(np.arange(250) / 25.0)}
    instants_s = shared_instants(list(times.values()))
    assert instants_s[:3] == pytest.approx([0.0, 0.1, 0.2])
    found = find_tracklets([camera], times, {camera.name: walkers(walk, crossing)}, SET, instants_s)
    for one in found:
        # Nobody turns round: each tracklet is one person.
        x = one.points_px[:, 0, 0]
        assert (np.diff(x) > 0).all() or (np.diff(x) < 0).all()
    # Two people meet, stand before each other, and go back, or on: nobody can tell.
    meeting = np.where(np.abs(crossing[..., :1] - 500.0) < 60.0, [500.0, 300.0], crossing)
    met = find_tracklets([camera], times, {camera.name: walkers(walk, meeting)}, SET, instants_s)
    assert not any({0, len(instants_s) - 1} <= set(one.instants) for one in met)
    apart = crossing + np.array([[0.0, 0.0], [0.0, 300.0]])
    found = find_tracklets([camera], times, {camera.name: walkers(walk, apart)}, SET, instants_s)
    assert [len(one.instants) for one in found] == [len(instants_s)] * 2


def test_points_are_interpolated_but_not_over_gaps(walk: Simulation) -> None:
    camera = walk.cameras[0]
    time_s = np.arange(250) / 25.0 + 0.013
    places = np.column_stack([100.0 * time_s, np.full(250, 300.0)])[:, None]
    times = {camera.name: FrameTimes(time_s)}
    instants_s = shared_instants([FrameTimes(np.array([0.0, 10.0]))])
    (found,) = find_tracklets([camera], times, {camera.name: walkers(walk, places)}, SET, instants_s)
    assert found.points_px[:, 0, 0] == pytest.approx(100.0 * instants_s[found.first : found.instants.stop])
    whole = walkers(walk, places)
    kept = (whole.frame < 100) | (whole.frame > 130)
    cut = Detections(camera.name, whole.frame[kept], whole.keypoints_px[kept], whole.score[kept], whole.box_px[kept])
    found_two = find_tracklets([camera], times, {camera.name: cut}, SET, instants_s)
    assert len(found_two) == 2


def test_two_cameras_find_who_is_who_and_their_relative_pose(walk: Simulation) -> None:
    instants_s = shared_instants(list(walk.times.values()))
    tracklets = find_tracklets(walk.cameras, walk.times, walk.detections, walk.joints, instants_s)
    relative = relate_by_people((0, 1), tracklets, np.array([camera.matrix[0, 0] for camera in walk.cameras]))
    assert relative is not None
    first, second = (walk.cameras[k].cam_from_world for k in (0, 1))
    true = second @ first.inverse()
    turn = true.rotation.T @ relative.second_from_first.rotation
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 5.0
    direction = true.translation_m / np.linalg.norm(true.translation_m)
    assert direction @ relative.second_from_first.translation_m > np.cos(np.radians(5.0))
    # Every match joins two tracklets of one true person.
    assert relative.matches
    for match in relative.matches:
        people = {person_of(walk, tracklets[number], instants_s) for number in (match.first, match.second)}
        assert len(people) == 1


def person_of(simulation: Simulation, tracklet: ViewTracklet, instants_s: np.ndarray) -> int:
    """Person whose joints are closest to a tracklet."""
    camera = simulation.cameras[tracklet.camera]
    frames = np.rint(instants_s[np.asarray(tracklet.instants)] * simulation.timebase.frame_rate_hz).astype(int)
    frames = np.minimum(frames, simulation.timebase.num_frames - 1)
    columns = simulation.joints.indices(JOINTS)
    true_px = project(camera, simulation.truth_m[:, frames][:, :, columns])
    distance_px = np.nanmedian(np.linalg.norm(true_px - tracklet.points_px, axis=-1), axis=(1, 2))
    return int(np.argmin(distance_px))


def test_sampson_distance_is_that_to_epipolar_line() -> None:
    # A sideways camera: epipolar lines are rows, and both points move half of the difference.
    essential = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    left, right = np.array([[0.1, 0.2], [0.0, 0.0]]), np.array([[0.5, 0.2], [0.3, 0.1]])
    assert sampson(essential, left, right) == pytest.approx([0.0, 0.1 / np.sqrt(2)])


def of_groups(estimates: list[float], weights: list[float]) -> Statures:
    return Statures(np.array(estimates), np.array(weights), np.arange(len(estimates)))


def at_once(num_groups: int, *pairs: tuple[int, int]) -> np.ndarray:
    are_others = np.zeros((num_groups, num_groups), bool)
    for first, second in pairs:
        are_others[first, second] = are_others[second, first] = True
    return are_others


def test_statures_scale_world_whoever_is_who() -> None:
    # The third group is the first person at another time.
    found = of_groups([2.0, 1.8, 2.05], [100.0, 80.0, 10.0])
    match = match_statures(found, at_once(3, (0, 1), (1, 2)), [0.9, 1.0])
    assert match.scale == pytest.approx(0.5)
    assert match.stature.tolist() == [1, 0, 1]
    assert scale_from(found, 1.7) == pytest.approx(1.7 / 2.0)


def test_people_who_are_seen_at_once_have_different_statures() -> None:
    # The nearest statures alone would give both the first one.
    found = of_groups([1.02, 0.98], [100.0, 100.0])
    assert match_statures(found, at_once(2, (0, 1)), [1.7, 1.2]).stature.tolist() == [0, 1]
    assert len(set(match_statures(found, at_once(2), [1.7, 1.2]).stature.tolist())) == 1


def test_child_beside_two_adults() -> None:
    found = of_groups([3.6, 2.7, 3.0], [80.0, 80.0, 80.0])
    pairs = ((0, 1), (1, 2), (0, 2))
    match = match_statures(found, at_once(3, *pairs), [1.49, 1.78, 1.34])
    assert match.stature.tolist() == [1, 2, 0]
    assert match.scale == pytest.approx(0.5, rel=0.02)
    # Of three people one has no stature left; of two a stature is left.
    assert sorted(match_statures(found, at_once(3, *pairs), [1.78, 1.34]).stature.tolist()) == [-1, 0, 1]
    assert match_statures(
        of_groups([3.6, 2.7], [80.0, 80.0]), at_once(2, (0, 1)), [1.49, 1.8, 1.35]
    ).stature.tolist() == [1, 2]


def test_two_groups_at_one_place_are_one_person(walk: Simulation) -> None:
    xyz_m = walk.truth_m[:, :50][:, :, walk.joints.indices(JOINTS)]
    both = np.concatenate([xyz_m[0], xyz_m[0] + 0.05, xyz_m[1]])
    group, instant = np.repeat([4, 7, 9], 50), np.tile(np.arange(50), 3)
    found = statures(both, group)
    assert found.group.tolist() == [4, 7, 9]
    expected = at_once(3, (0, 2), (1, 2))
    np.testing.assert_array_equal(others_at_once(found, both, group, instant), expected)
    later = np.concatenate([np.arange(100), np.arange(200, 250)])
    assert not others_at_once(found, both, group, later).any()


def test_person_without_legs_has_no_stature(walk: Simulation) -> None:
    columns = walk.joints.indices(JOINTS)
    xyz_m = walk.truth_m[0][:, columns].copy()
    group = np.zeros(len(xyz_m), int)
    assert 1.4 < statures(xyz_m, group).estimates[0] < 2.1
    xyz_m[:, -2:] = np.nan
    assert len(statures(xyz_m, group)) == 0


def doubts(
    walk: Simulation, fitting: list[float], estimates_m: list[float], stature: list[int], stature_m: list[float]
) -> list[tuple[str, str | None, str]]:
    """Warnings of a calibration of three cameras."""
    reports = [CameraReport(camera.name, 2.0, 760.0, 200, np.nan, 5.0, 0.1) for camera in walk.cameras]
    world = PeopleWorld(walk.cameras, 1.0, True, tuple(estimates_m), tuple(stature))
    problems = people_warnings(reports, np.array(fitting), world, stature_m, 10.0)
    return [(problem.code, problem.camera, problem.message) for problem in problems]


def test_camera_that_takes_somebody_for_another_one_is_named(walk: Simulation) -> None:
    assert not doubts(walk, [0.99, 0.97, 0.98], [1.75], [0], [1.7])
    ((code, camera, message),) = doubts(walk, [0.99, 0.97, 0.5], [1.75], [0], [1.7])
    assert (code, camera) == ("people_poor_fit", "cam_02")
    assert message.startswith("50 % of the people's joints in this camera")


def test_statures_that_are_not_those_of_people_are_named(walk: Simulation) -> None:
    fits = [1.0, 1.0, 1.0]
    assert not doubts(walk, fits, [1.75, 1.38], [0, 1], [1.78, 1.34])
    # One stature is that of all, however tall they are.
    assert not doubts(walk, fits, [1.9, 1.4], [0, 0], [1.7])
    for estimates_m, stature, stature_m, words in (
        ([1.78, 1.34, 1.5], [0, 1, -1], [1.78, 1.34], "More people are seen at once than statures"),
        ([1.78, 1.34], [0, 1], [1.78, 1.34, 1.6], "no person has 1.60 m"),
        ([1.78, 1.6], [0, 1], [1.78, 1.34], "the person of 1.34 m is 1.60 m tall"),
    ):
        ((code, _, message),) = doubts(walk, fits, estimates_m, stature, stature_m)
        assert code == "people_statures"
        assert words in message
