"""Named scenes: complete, reproducible and as specified."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.errors import InputError
from pipeline.geometry.camera import project
from pipeline.motion.body_segments import ANGLE_NAMES
from pipeline.motion.skeleton.rotations import unit
from pipeline.validation.simulation.motion.director import Cast
from pipeline.validation.simulation.rigs import Clock, frame_times
from pipeline.validation.simulation.scenes import JOINT_SETS, SCENES, Joints, Simulation, known_joints, record, simulate
from pipeline.validation.simulation.views.detector import PERFECT, UNASSIGNED
from tests.acrobatics.scenes import ALL_SCENES
from tests.cases import slow_but

NAMES = (
    "room", "store", "store-large", "outdoor", "unsynchronised", "crowd", "handshake", "noisy", "comings-and-goings",
    "contact", "crowd-2", "crowd-3", "crowd-5", "walk", "sports", "exchange", "hands",
)  # fmt: skip
HIPS = (11, 12)


def short(name: str, seed: int = 1, duration_s: float = 3.0, num_views: int | None = 4) -> Simulation:
    return record(replace(ALL_SCENES[name], duration_s=duration_s), seed, num_views)


def everything(simulation: Simulation) -> bytes:
    arrays = [simulation.truth_m, simulation.present]
    for camera in simulation.cameras:
        detections = simulation.detections[camera.name]
        arrays += [
            camera.matrix,
            camera.distortion,
            camera.cam_from_world.rotation,
            camera.cam_from_world.translation_m,
        ]
        arrays += [simulation.times[camera.name].time_s, simulation.identities[camera.name]]
        arrays += [detections.frame, detections.keypoints_px, detections.score, detections.box_px]
    return b"".join(array.tobytes() for array in arrays)


def test_all_scenes_are_there() -> None:
    assert set(SCENES) == set(NAMES)


@pytest.mark.parametrize(
    "name", slow_but(("unsynchronised", "contact", "comings-and-goings", "hands", "roll"), ALL_SCENES)
)
def test_records_fit_together(name: str) -> None:
    simulation = short(name)
    num_people, num_frames = simulation.present.shape
    assert simulation.truth_m.shape == (num_people, num_frames, len(simulation.joints.names), 3)
    assert num_frames == simulation.timebase.num_frames == round(3.0 * simulation.timebase.frame_rate_hz)
    np.testing.assert_array_equal(np.isfinite(simulation.truth_m).all((2, 3)), simulation.present)
    assert len(simulation.cameras) == 4
    names = {camera.name for camera in simulation.cameras}
    assert set(simulation.times) == set(simulation.detections) == set(simulation.identities) == names
    for camera in names:
        detections, identity = simulation.detections[camera], simulation.identities[camera]
        assert detections.camera == camera
        assert len(identity) == len(detections.frame)
        assert detections.frame.max(initial=0) < len(simulation.times[camera].time_s)
        assert UNASSIGNED <= identity.min(initial=0) <= identity.max(initial=0) < num_people
        np.testing.assert_array_equal(np.isnan(detections.keypoints_px).any(-1), detections.score == 0)


@pytest.mark.parametrize("name", ["comings-and-goings", "squat", "kick"])
def test_true_angles_are_those_of_true_joints(name: str) -> None:
    """Angles come from rotations; hinges can be measured at the joints too."""
    simulation = record(replace(ALL_SCENES[name], duration_s=4.0), 1, 2, "feet")
    present = simulation.present
    for angle, above, middle, below in (
        ("left_knee_flexion", "left_hip", "left_knee", "left_ankle"),
        ("right_elbow_flexion", "right_shoulder", "right_elbow", "right_wrist"),
    ):
        found_deg = simulation.truth_deg[..., ANGLE_NAMES.index(angle)]
        start_m, joint_m, end_m = (
            simulation.truth_m[:, :, simulation.joints.index(joint)] for joint in (above, middle, below)
        )
        upper, lower = unit(joint_m - start_m), unit(end_m - joint_m)
        bend_deg = np.degrees(np.arctan2(np.linalg.norm(np.cross(upper, lower), axis=-1), (upper * lower).sum(-1)))
        np.testing.assert_allclose(np.abs(found_deg[present]), bend_deg[present], atol=1e-6)
        assert np.isnan(found_deg[~present]).all()
    assert np.isnan(simulation.truth_deg[..., ANGLE_NAMES.index("left_wrist_flexion")]).all()
    assert np.isfinite(simulation.truth_deg[..., ANGLE_NAMES.index("left_ankle_dorsiflexion")][present]).all()


@pytest.mark.parametrize("name", ["handshake", "noisy", "unsynchronised", pytest.param("roll", marks=pytest.mark.slow)])
def test_seed_gives_same_bytes(name: str) -> None:
    assert everything(short(name, 7)) == everything(short(name, 7))
    assert everything(short(name, 7)) != everything(short(name, 8))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("walk", "e6d7a1f277d58350"),
        ("noisy", "1a48ece1331dfdd6"),
        ("handshake", "0e000597da06e0a5"),
        ("contact", "2e4369d207440aa3"),
    ],
)
def test_bodies_of_seeds_are_those_of_version_0_1(name: str, expected: str) -> None:
    """Truth, detections and fields, rounded so that the last bits of a machine's arithmetic do not matter."""
    simulation = record(replace(ALL_SCENES[name], duration_s=2.0), 5, 3)
    arrays = [simulation.truth_m]
    for camera in simulation.cameras:
        found = simulation.detections[camera.name]
        arrays += [found.frame, found.keypoints_px, found.score, found.box_px]
    for content in simulation.sketches:
        arrays += [content.points_px, content.amplitude]
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.round(np.asarray(array, float), 3).tobytes())
    assert digest.hexdigest()[:16] == expected


@pytest.mark.parametrize("joints", ["feet", "whole"])
def test_acrobats_move_same_whatever_joints_are_asked_for(joints: Joints) -> None:
    scene = replace(ALL_SCENES["kneel"], duration_s=0.6)
    body, more = record(scene, 3), record(scene, 3, joints=joints)
    assert more.truth_m.shape[2] == len(more.joints.names)
    np.testing.assert_array_equal(more.truth_m[:, :, :17], body.truth_m)


@pytest.mark.parametrize("joints", ["feet", "whole"])
def test_joints_are_those_asked_for(joints: Joints) -> None:
    scene = replace(ALL_SCENES["hands"], duration_s=2.0)
    body, more = record(scene, 3), record(scene, 3, joints=joints)
    assert more.joints == JOINT_SETS[joints]
    assert more.truth_m.shape[2] == len(more.joints.names)
    np.testing.assert_array_equal(more.truth_m[:, :, :13], body.truth_m[:, :, :13])
    assert everything(more) == everything(record(scene, 3, joints=joints))
    for camera in body.cameras:
        found, plain = more.detections[camera.name], body.detections[camera.name]
        np.testing.assert_array_equal(found.frame, plain.frame)
        np.testing.assert_array_equal(found.score[:, :5], plain.score[:, :5])
        np.testing.assert_array_equal(found.keypoints_px[:, :5], plain.keypoints_px[:, :5])


def test_perfect_detections_of_extremities_project_truth() -> None:
    simulation = record(replace(ALL_SCENES["hands"], duration_s=3.0, detector=PERFECT), 3, joints="whole")
    for camera in simulation.cameras:
        detections, identity = simulation.detections[camera.name], simulation.identities[camera.name]
        expected = project(camera, simulation.truth_m[identity, detections.frame])
        seen = detections.score > 0
        assert seen.all(0).mean() > 0.9
        np.testing.assert_allclose(detections.keypoints_px[seen], expected[seen], atol=1e-9)


def test_camera_records_same_whatever_others() -> None:
    few, all_of_them = short("noisy", num_views=2), short("noisy", num_views=5)
    for camera in few.cameras:
        np.testing.assert_array_equal(
            few.detections[camera.name].keypoints_px, all_of_them.detections[camera.name].keypoints_px
        )
    np.testing.assert_array_equal(few.truth_m, all_of_them.truth_m)


def test_perfect_detections_are_projections_of_truth() -> None:
    simulation = record(replace(ALL_SCENES["room"], duration_s=4.0, detector=PERFECT), 3)
    for camera in simulation.cameras:
        detections, identity = simulation.detections[camera.name], simulation.identities[camera.name]
        expected = project(camera, simulation.truth_m[identity, detections.frame])
        seen = detections.score > 0
        assert seen.mean() > 0.9
        np.testing.assert_allclose(detections.keypoints_px[seen], expected[seen], atol=1e-9)


def test_unsynchronised_cameras_see_what_is_true_at_their_times() -> None:
    simulation = record(replace(ALL_SCENES["unsynchronised"], duration_s=4.0, detector=PERFECT), 3)
    time_s = np.arange(simulation.timebase.num_frames) / simulation.timebase.frame_rate_hz
    for camera in simulation.cameras:
        detections, identity = simulation.detections[camera.name], simulation.identities[camera.name]
        when_s = simulation.times[camera.name].time_s[detections.frame]
        after = np.searchsorted(time_s, when_s).clip(1, len(time_s) - 1)
        inside = when_s <= time_s[-1]
        share = ((when_s - time_s[after - 1]) / (time_s[after] - time_s[after - 1]))[:, None, None]
        truth_m = (1 - share) * simulation.truth_m[identity, after - 1] + share * simulation.truth_m[identity, after]
        error_px = np.linalg.norm(project(camera, truth_m) - detections.keypoints_px, axis=-1)[inside]
        # Only the curvature of the path between two output frames is left.
        assert np.nanmedian(error_px) < 0.1
        assert np.nanpercentile(error_px, 99) < 3.0


def test_frame_times() -> None:
    clock = Clock(30.0, camera_rates_hz=(30.0, 25.0), random_phase=True, dropped=0.1)
    first, second = (frame_times(clock, number, 100.0, np.random.default_rng(number)).time_s for number in (0, 1))
    assert len(first) == pytest.approx(2700, abs=60)
    assert len(second) == pytest.approx(2250, abs=60)
    for time_s, rate_hz in ((first, 30.0), (second, 25.0)):
        steps = np.diff(time_s) * rate_hz
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
        assert time_s[0] >= 0
        assert time_s[-1] < 100.0
    assert (first[0] * 30) % 1 != pytest.approx(0.0, abs=1e-3)


def test_synchronised_cameras_share_their_times() -> None:
    simulation = short("handshake")
    for times in simulation.times.values():
        np.testing.assert_array_equal(times.time_s, np.arange(75) / 25.0)


@pytest.mark.parametrize("name", ["room", "outdoor", "comings-and-goings"])
def test_people_keep_their_distance(name: str) -> None:
    simulation = short(name, duration_s=20.0, num_views=1)
    hips_m = simulation.truth_m[:, :, HIPS, :2].mean(2)
    distance_m = np.linalg.norm(hips_m[:, None] - hips_m, axis=-1)[np.triu_indices(len(hips_m), 1)]
    assert np.nanmin(distance_m) > 0.5


def test_crowd_is_close() -> None:
    simulation = short("crowd", num_views=1)
    hips_m = simulation.truth_m[:, :, HIPS, :2].mean(2)
    distance_m = np.linalg.norm(hips_m[:, None] - hips_m, axis=-1) + np.diag(np.full(7, np.inf))[..., None]
    assert np.median(distance_m.min(1)) < 0.9


def test_people_walk_around_boxes() -> None:
    scene = replace(ALL_SCENES["store"], duration_s=20.0)
    hips_m = record(scene, 2, 1).truth_m[:, :, HIPS, :2].mean(2)
    for box in scene.boxes:
        assert not ((hips_m > box.min_m[:2]) & (hips_m < box.max_m[:2])).all(-1).any()


def test_people_come_and_go() -> None:
    simulation = short("comings-and-goings", duration_s=60.0, num_views=1)
    entries = np.sum(np.diff(simulation.present.astype(int), axis=1) == 1, axis=1)
    assert (entries >= 2).all()
    assert 0.4 < simulation.present.mean() < 0.95


def test_hands_are_shaken() -> None:
    simulation = short("handshake", duration_s=20.0, num_views=1)
    right_wrist = simulation.joints.index("right_wrist")
    for first, second in ((0, 1), (2, 3)):
        apart_m = np.linalg.norm(
            simulation.truth_m[first, :, right_wrist] - simulation.truth_m[second, :, right_wrist], axis=-1
        )
        assert (apart_m < 0.2).mean() > 0.1


@pytest.mark.parametrize(
    "name", slow_but(["comings-and-goings"], ["room", "outdoor", "crowd", "handshake", "comings-and-goings"])
)
def test_everybody_is_seen_by_two_cameras_most_of_time(name: str) -> None:
    simulation = short(name, duration_s=10.0, num_views=ALL_SCENES[name].rig.num_cameras if name != "crowd" else 6)
    views = np.zeros(simulation.present.shape, dtype=int)
    for camera in simulation.cameras:
        identity, frame = simulation.identities[camera.name], simulation.detections[camera.name].frame
        seen = np.zeros(views.shape, dtype=bool)
        seen[identity[identity != UNASSIGNED], frame[identity != UNASSIGNED]] = True
        views += seen
    assert (views[simulation.present] >= 2).mean() > 0.95


def test_bad_requests_are_named_together() -> None:
    with pytest.raises(InputError) as caught:
        simulate("room", -1, 9)
    assert [problem.field for problem in caught.value.problems] == ["views", "seed"]
    with pytest.raises(InputError, match="comings-and-goings"):
        simulate("moon", 1)
    with pytest.raises(InputError, match="body, feet, whole"):
        known_joints("face")


def test_casts_are_as_large_as_asked_for() -> None:
    scene = replace(ALL_SCENES["room"], cast=Cast(5, (4.0, 4.0)), duration_s=2.0)
    assert record(scene, 1, 1).truth_m.shape[0] == 5


@pytest.mark.slow
def test_people_who_exchange_places_stay_close_and_walk() -> None:
    simulation = record(replace(ALL_SCENES["exchange"], duration_s=12.0), 2)
    hips_m = simulation.truth_m[:, :, simulation.joints.indices(("left_hip", "right_hip"))].mean(2)[..., :2]
    assert len(hips_m) == 7
    assert np.linalg.norm(hips_m, axis=-1).max() < 0.9
    apart_m = np.linalg.norm(hips_m[:, None] - hips_m, axis=-1) + 9 * np.eye(7)[..., None]
    assert np.median(apart_m.min(1)) == pytest.approx(0.5, abs=0.05)
    assert (np.linalg.norm(hips_m[:, -1] - hips_m[:, 0], axis=-1) > 0.4).sum() >= 2
    assert simulation.truth_m.tobytes() == record(replace(ALL_SCENES["exchange"], duration_s=12.0), 2).truth_m.tobytes()
