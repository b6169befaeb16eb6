"""Animation of simulated people, with known feet and elbows."""

from dataclasses import replace
from functools import cache
from weakref import ref

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Observations, Source, Track3D
from pipeline.core.joints import BODY_25, COCO_17
from pipeline.core.options.config import Feet, ReconstructionConfig, Smoothing
from pipeline.geometry.camera import project
from pipeline.motion.skeleton import time_series
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting.articulation import ARM_HINGES, KNEE_HINGE
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics, joint_pose
from pipeline.run.engine.stored_people import StoredSequence
from pipeline.validation.evaluation.extremity_errors import score_feet
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from pipeline.validation.simulation.views.detector import DetectorAccuracy
from pipeline.validation.simulation.views.faults import Faults
from tests.cases import slow_but
from tests.pipeline.conftest import ring_camera
from tests.pipeline.motion.skeleton.synthetic_tracks import walker

HARD = DetectorAccuracy(noise_m=0.0, noise_px=3.0, faults=Faults(miss_joint=0.2, swap=0.05))
_Found = tuple[tuple[Track3D, ...], tuple[Observations, ...]]


@cache
def recorded(scene: str, duration_s: float, hard: bool = False) -> tuple[Simulation, _Found]:
    chosen = replace(find_scene(scene), duration_s=duration_s)
    simulation = record(replace(chosen, detector=HARD) if hard else chosen, seed=11)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    return simulation, reconstruct_tracks(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, parameters
    )


@cache
def animated(
    scene: str, duration_s: float, hard: bool = False, smoothing: Smoothing = "fit", feet: Feet = "auto"
) -> Animation:
    simulation, found = recorded(scene, duration_s, hard)
    config = ReconstructionConfig(smoothing=smoothing, feet=feet)
    return animate(*found, simulation.cameras, simulation.timebase, simulation.joints, config)


def bend_rad(motion: SkeletonMotion, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Rotation of a hinge about its axis, and the remaining rotation."""
    hinge = np.array(KNEE_HINGE if name.endswith("Leg") else ARM_HINGES[name.removesuffix("ForeArm")])
    rotvec = Rotation.from_quat(motion.parent_from_joint[:, INDEX[name]]).as_rotvec()
    along = rotvec @ hinge
    return along, np.linalg.norm(rotvec - along[:, None] * hinge, axis=-1)


@pytest.mark.parametrize("smoothing", slow_but(["fit"], ["fit", "none", "butterworth"]))
def test_elbows_and_knees_bend_within_extremes_of_people(smoothing: Smoothing) -> None:
    for motion in animated("room", 6.0, hard=True, smoothing=smoothing).motions:
        for name in ("LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg"):
            along, aside = bend_rad(motion, name)
            assert along.min() >= np.radians(-12.0) - 1e-9
            assert along.max() <= np.radians(165.0 if name.endswith("Leg") else 155.0) + 1e-9
            assert aside.max() < 1e-6


def test_joints_are_where_skeleton_has_them() -> None:
    animation = animated("room", 6.0, hard=True)
    for track, motion in zip(animation.tracks, animation.motions, strict=True):
        posed_m = forward_kinematics(motion)
        for joint in SKELETON:
            if len(joint.landmarks) == 1:
                seen_m = track.xyz_m[:, COCO_17.index(joint.landmarks[0])]
                known = np.isfinite(seen_m).all(-1)
                np.testing.assert_allclose(seen_m[known], posed_m[known, INDEX[joint.name]], atol=1e-6)


@pytest.mark.slow
def test_nothing_flips() -> None:
    """No joint turns by more than 45 degrees between frames, with noise, misses and fast motion."""
    for motion in animated("outdoor", 6.0, hard=True).motions:
        quat = motion.parent_from_joint
        cosine = np.abs((quat[1:] * quat[:-1]).sum(-1))
        assert np.degrees(2 * np.arccos(np.clip(cosine, 0.0, 1.0))).max() < 45.0
        np.testing.assert_allclose(np.linalg.norm(quat, axis=-1), 1.0)


@pytest.mark.parametrize("hard", [pytest.param(False, marks=pytest.mark.slow), True])
def test_feet_of_walk_stand_still(hard: bool) -> None:
    simulation, _ = recorded("walk", 10.0, hard)
    off, auto = (animated("walk", 10.0, hard, feet=feet) for feet in ("off", "auto"))
    before, after = (score_feet(one.tracks, one.motions, simulation, COCO_17) for one in (off, auto))
    assert before["foot_slide_cm"] is not None
    assert before["foot_slide_cm"] > 0.5  # there is something to hold
    assert after["foot_slide_cm"] is not None
    assert after["foot_slide_cm"] <= 0.2
    assert after["ankle_mm"] is not None
    assert before["ankle_mm"] is not None
    assert after["ankle_mm"] <= before["ankle_mm"] + 5.0
    assert after["contacts_found"] is not None
    assert after["contacts_found"] > 0.9
    floor = auto.floor
    assert floor is not None
    assert abs(floor.z_m) < 0.04
    assert floor.tilt_deg < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("hard", [False, True])
def test_no_contact_is_invented_in_running_and_jumping(hard: bool) -> None:
    simulation, _ = recorded("sports", 6.0, hard)
    animation = animated("sports", 6.0, hard)
    scores = score_feet(animation.tracks, animation.motions, simulation, COCO_17)
    assert scores["contacts_invented"] is not None
    assert scores["contacts_invented"] <= 0.02
    assert scores["contacts_found"] is not None
    assert scores["contacts_found"] > 0.8


@pytest.mark.slow
def test_holding_feet_makes_nothing_pop() -> None:
    def fastest_m_s2(animation: Animation) -> float:
        ankles_m = [joint_pose(motion, f"{side}Foot")[0] for motion in animation.motions for side in ("Left", "Right")]
        return max(np.linalg.norm(np.diff(one, n=2, axis=0), axis=-1).max() for one in ankles_m) * 25.0**2

    assert fastest_m_s2(animated("walk", 10.0, True)) < 1.3 * fastest_m_s2(animated("walk", 10.0, True, feet="off"))


@pytest.mark.parametrize("smoothing", slow_but(["one-euro"], ["none", "butterworth", "one-euro"]))
def test_feet_are_held_whatever_smoothing(smoothing: Smoothing) -> None:
    animation = animated("walk", 10.0, smoothing=smoothing)
    contacts = [contact for motion in animation.motions for contact in motion.contacts if contact.pinned]
    before, after = (np.mean([getattr(one, f"slide_{when}_m") for one in contacts]) for when in ("before", "after"))
    assert after < 0.005 < before
    if smoothing == "none":
        located = recorded("walk", 10.0)[1][0]
        for one, other in zip(animation.tracks, located, strict=True):
            np.testing.assert_array_equal(one.xyz_m, other.xyz_m)


@pytest.mark.slow
def test_feet_without_toes_stand_level_and_follow_shins() -> None:
    motion = animated("walk", 10.0).motions[0]
    _, world_from_foot = joint_pose(motion, "LeftFoot")
    up = world_from_foot.apply([0.0, 0.0, 1.0])[:, 2]
    standing = np.zeros(len(up), bool)
    for contact in motion.contacts:
        if contact.side == "left":
            standing[contact.rows] = True
    assert np.degrees(np.arccos(np.clip(up[standing], -1.0, 1.0))).max() < 10.0
    quat = motion.parent_from_joint[:, INDEX["LeftFoot"]]
    assert (np.abs(quat[:, 3]) > 1 - 1e-12).any()  # at rest to the shin in mid-swing


@pytest.mark.slow
def test_windows_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, found = recorded("walk", 10.0)
    whole = animated("walk", 10.0)
    monkeypatch.setattr(time_series, "_WINDOW_FRAMES", 120)
    cut = animate(*found, simulation.cameras, simulation.timebase, COCO_17, ReconstructionConfig())
    for one, other in zip(whole.motions, cut.motions, strict=True):
        assert np.linalg.norm(forward_kinematics(one) - forward_kinematics(other), axis=-1).max() < 0.03
        quat = other.parent_from_joint
        assert np.abs((quat[1:] * quat[:-1]).sum(-1)).min() > np.cos(np.radians(25.0) / 2)


def test_toes_turn_feet() -> None:
    """A person with visible heels and toes, whose feet point outwards by 30 degrees."""
    num_frames, cameras = 40, tuple(ring_camera(f"cam{k}", angle) for k, angle in enumerate(np.radians([10, 130, 250])))
    coco_m = walker(num_frames) * [1.0, 1.0, 1.0] - [1.0, 1.6, 0.0]
    true_m = np.full((num_frames, 25, 3), np.nan)
    for number, name in enumerate(BODY_25.names):
        if name in COCO_17.names:
            true_m[:, number] = coco_m[:, COCO_17.index(name)]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out = Rotation.from_euler("z", sign * 30.0, degrees=True)
        for name, offset_m in (
            ("heel", [0, 0.05, -0.06]),
            ("big_toe", [0, -0.17, -0.066]),
            ("small_toe", [sign * 0.07, -0.14, -0.066]),
        ):
            ankle_m = coco_m[:, COCO_17.index(f"{side}_ankle")]
            true_m[:, BODY_25.index(f"{side}_{name}")] = ankle_m + out.apply(offset_m)
    points_px = np.stack([project(camera, true_m) for camera in cameras], axis=1)
    score = np.where(np.isfinite(points_px[..., 0]), 0.9, 0.0)
    source = np.where(np.isfinite(true_m[..., 0]), Source.MEASURED, Source.ABSENT).astype(np.int8)
    track = Track3D(1, 0, true_m, score.max(1), source, np.zeros(source.shape), (score > 0).sum(1))
    timebase = Timebase(0.0, 30.0, num_frames)
    config = ReconstructionConfig(feet="off")
    animation = animate([track], [Observations(1, points_px, score)], cameras, timebase, BODY_25, config)
    found_m = animation.tracks[0].xyz_m
    toes = BODY_25.indices(("left_big_toe", "right_big_toe", "left_heel", "right_heel"))
    assert np.linalg.norm(found_m[:, toes] - true_m[:, toes], axis=-1).max() < 0.02
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        end_m, ankle_m = (
            forward_kinematics(animation.motions[0])[:, INDEX[f"{side}{name}"]] for name in ("FootEnd", "Foot")
        )
        ahead = (end_m - ankle_m)[:, :2]
        heading_deg = np.degrees(np.arctan2(ahead[:, 0], -ahead[:, 1]))
        np.testing.assert_allclose(heading_deg, sign * 30.0, atol=15.0)


@pytest.mark.parametrize("num_frames", [1, 2, 3])
def test_short_tracks(num_frames: int) -> None:
    cameras = tuple(ring_camera(f"cam{k}", angle) for k, angle in enumerate(np.radians([10, 130, 250])))
    true_m = walker(num_frames) - [1.0, 2.0, 0.0]
    points_px = np.stack([project(camera, true_m) for camera in cameras], axis=1)
    shape = true_m.shape[:2]
    track = Track3D(1, 0, true_m, np.ones(shape), np.ones(shape, np.int8), np.zeros(shape), np.full(shape, 3))
    seen = Observations(1, points_px, np.full(points_px.shape[:3], 0.9))
    animation = animate([track], [seen], cameras, Timebase(0.0, 30.0, num_frames), COCO_17, ReconstructionConfig())
    assert np.linalg.norm(animation.tracks[0].xyz_m - true_m, axis=-1).max() < 0.02


def test_nobody() -> None:
    animation = animate([], [], [], Timebase(0.0, 25.0, 10), COCO_17, ReconstructionConfig())
    assert (animation.tracks, animation.motions, animation.floor) == ((), (), None)


@pytest.mark.slow
def test_every_window_reports_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_series, "_WINDOW_FRAMES", 120)
    simulation, found = recorded("walk", 10.0)
    shares: list[float] = []
    cameras, timebase = simulation.cameras, simulation.timebase
    animate(*found, cameras, timebase, simulation.joints, ReconstructionConfig(), shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert np.diff([0.0, *shares]).max() < 0.2


def test_observations_of_one_person_at_time_are_in_memory() -> None:
    simulation, (tracks, observations) = recorded("room", 6.0, hard=True)
    assert len(tracks) > 2
    scores: list[ref[np.ndarray]] = []
    most_alive = 0

    def read(number: int) -> Observations:
        nonlocal most_alive
        score = observations[number].score.copy()
        scores.append(ref(score))
        most_alive = max(most_alive, sum(each() is not None for each in scores))
        return replace(observations[number], score=score)

    stored = StoredSequence(len(observations), read)
    given = simulation.cameras, simulation.timebase, simulation.joints, ReconstructionConfig()
    found = animate(tracks, stored, *given)
    assert most_alive == 1
    for track, same in zip(found.tracks, animated("room", 6.0, hard=True).tracks, strict=True):
        np.testing.assert_array_equal(track.xyz_m, same.xyz_m)
