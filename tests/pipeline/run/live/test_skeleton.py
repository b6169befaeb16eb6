"""Skeletons while people move: bones, poses, and the error beside that of the finished fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.core.data.animation import Animation, SkeletonMotion
from pipeline.core.joints import MARKED_AT_CENTERS, JointOffset
from pipeline.core.options.config import ReconstructionConfig
from pipeline.geometry.camera import project
from pipeline.motion.skeleton.animate import animate
from pipeline.motion.skeleton.fitting.articulation import articulate
from pipeline.motion.skeleton.fitting.gauss_newton import Posed, refine, start_from
from pipeline.motion.skeleton.model import INDEX, SKELETON, forward_kinematics
from pipeline.run.live.capture import LiveCapture
from pipeline.run.live.pose_steps import PoseSteps, quaternions_from_matrices
from pipeline.run.live.records import LiveInstant
from pipeline.run.live.settings import LiveSettings
from pipeline.run.live.skeleton import PoseEvidence
from pipeline.validation.simulation.scenes import SCENES, Simulation, record
from tests.pipeline.run.live.streams import play, sent_frames

RATE_HZ = 25.0


@pytest.fixture(scope="module")
def room() -> Simulation:
    return record(replace(SCENES["room"], duration_s=8.0), 1)


@pytest.fixture(scope="module")
def instants(room: Simulation) -> list[LiveInstant]:
    return play(LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ)), sent_frames(room))


@pytest.fixture(scope="module")
def finished(room: Simulation) -> Animation:
    people = reconstruct_tracks(
        room.cameras, room.times, room.detections, room.timebase, derive_parameters(room.cameras, RATE_HZ)
    )
    return animate(*people, room.cameras, room.timebase, room.joints, ReconstructionConfig())


def errors_m(xyz_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """Errors of the joints to the nearest of the true people."""
    return min((np.linalg.norm(person_m - xyz_m, axis=-1) for person_m in truth_m), key=np.nanmean)


def test_error_is_near_that_of_finished_fit(room: Simulation, instants: list[LiveInstant], finished: Animation) -> None:
    """The same joints at the same instants; a skeleton cannot be as good as one that knows what follows."""
    live_m, finished_m = [], []
    for frame, instant in enumerate(instants):
        for person in instant.people:
            if person.skeleton is not None:
                live_m.append(errors_m(person.xyz_m, room.truth_m[:, frame]))
                tracks_m = [t.xyz_m[frame - t.start_frame] for t in finished.tracks if frame in t.frames]
                there_m = min(tracks_m, key=lambda xyz_m: np.nanmean(np.linalg.norm(xyz_m - person.xyz_m, axis=-1)))
                finished_m.append(errors_m(there_m, room.truth_m[:, frame]))
    live, fit = np.array(live_m), np.array(finished_m)
    is_known = np.isfinite(live) & np.isfinite(fit)
    assert is_known.sum() > 3 * 17 * 4.5 * RATE_HZ
    assert fit[is_known].mean() < 0.009
    assert live[is_known].mean() < 1.6 * fit[is_known].mean()


def test_skeletons_come_after_time_of_learning(instants: list[LiveInstant]) -> None:
    """Bones are learnt in three steps, one an instant and one person after the other, so that no instant waits long."""
    first_s: dict[int, float] = {}
    for instant in instants:
        for person in instant.people:
            if person.skeleton is not None:
                first_s.setdefault(person.id, instant.time_s)
    assert set(first_s) == {1, 2, 3}
    assert all(3.0 <= time_s <= 3.5 for time_s in first_s.values())
    assert np.diff(sorted(first_s.values())) == pytest.approx([3 / RATE_HZ] * 2)


def test_skeleton_is_pose_of_animation_skeleton(instants: list[LiveInstant]) -> None:
    """Forward kinematics of root, rotations and lengths gives the joints; lengths stay, rotations are continuous."""
    lengths_m: dict[int, np.ndarray] = {}
    before: dict[int, np.ndarray] = {}
    for instant in instants:
        for person in instant.people:
            skeleton = person.skeleton
            if skeleton is None:
                continue
            motion = SkeletonMotion(
                1, "", 0, RATE_HZ, skeleton.bone_length_m, skeleton.root_m[None], skeleton.parent_from_joint[None], ()
            )
            np.testing.assert_allclose(forward_kinematics(motion)[0], skeleton.joint_m, atol=1e-9)
            assert lengths_m.setdefault(person.id, skeleton.bone_length_m) is skeleton.bone_length_m
            if person.id in before:
                assert ((before[person.id] * skeleton.parent_from_joint).sum(-1) > 0.7).all()
            before[person.id] = skeleton.parent_from_joint
    assert set(before) == {1, 2, 3}


def test_lengths_are_those_of_finished_fit(instants: list[LiveInstant], finished: Animation) -> None:
    lengths_m = {p.id: p.skeleton.bone_length_m for i in instants for p in i.people if p.skeleton is not None}
    fitted_m = [motion.bone_length_m for motion in finished.motions]
    limbs = [INDEX[f"{side}{bone}"] for side in ("Left", "Right") for bone in ("ForeArm", "Hand", "Leg", "Foot")]
    for length_m in lengths_m.values():
        assert min(np.abs(length_m[limbs] / other_m[limbs] - 1.0).max() for other_m in fitted_m) < 0.05


def test_quaternions_are_those_of_scipy() -> None:
    """Also of half turns, about any axis."""
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(200, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    angle_rad = np.append(rng.uniform(0.0, np.pi, 150), np.full(50, np.pi))
    rotations = Rotation.concatenate([Rotation.from_rotvec(angle_rad[:, None] * axes), Rotation.identity(1)])
    again = Rotation.from_quat(quaternions_from_matrices(rotations.as_matrix()))
    assert (again * rotations.inv()).magnitude().max() < 1e-7


def test_steps_are_those_of_finished_fit(room: Simulation) -> None:
    """One frame without accelerations: the same energy, so the same pose after the same number of steps."""
    rng = np.random.default_rng(4)
    length_m = np.array([1.7 * joint.stature_share for joint in SKELETON])
    skeleton = articulate(length_m, room.joints, {"nose": np.array([0.0, -0.11, 0.0]), "left_ear": np.zeros(3)})
    count = len(skeleton.landmark)
    for _ in range(20):
        quat = Rotation.from_rotvec(rng.normal(0.0, 0.5, (len(SKELETON), 3))).as_quat()[None]
        by_fit, by_steps = (start_from(np.zeros((1, 3)), quat, skeleton) for _ in range(2))
        target_m = Posed(by_fit, skeleton).landmark_m[0] + rng.normal(0.0, 0.1, (count, 3))
        nothing = np.zeros((count, 1))
        evidence = PoseEvidence(np.zeros((count, 1, 3)), nothing, np.zeros((1, 3)), target_m, np.full(count, 1e-4))
        refine(by_fit, skeleton, evidence, np.full(count, np.inf), RATE_HZ, 3)
        PoseSteps(skeleton).take(by_steps, evidence, 3)
        np.testing.assert_allclose(by_steps.local, by_fit.local, atol=1e-7)
        np.testing.assert_allclose(by_steps.root_m, by_fit.root_m, atol=1e-7)


def test_feet_that_stand_hardly_slide(room: Simulation, instants: list[LiveInstant]) -> None:
    """Without holding them standing ankles move at 0.3 m/s, by the detector's noise."""
    ankles = room.joints.indices(("left_ankle", "right_ankle"))
    speeds_m_s, before = [], dict[int, np.ndarray]()
    for frame, instant in enumerate(instants):
        after = {each.id: each.skeleton.joint_m for each in instant.people if each.skeleton is not None}
        for number in before.keys() & after.keys():
            located_m = after[number][[INDEX["LeftFoot"], INDEX["RightFoot"]]]
            true_m = min(room.truth_m[:, frame, ankles], key=lambda each_m: np.linalg.norm(each_m - located_m))
            person = int(np.argmin(np.linalg.norm(room.truth_m[:, frame, ankles] - true_m, axis=(1, 2))))
            stands = np.linalg.norm(np.diff(room.truth_m[person, frame - 1 : frame + 1, ankles], axis=1)[:, 0], axis=-1)
            moved_m = np.linalg.norm(located_m - before[number][[INDEX["LeftFoot"], INDEX["RightFoot"]]], axis=-1)
            speeds_m_s += (moved_m[stands * RATE_HZ < 0.02] * RATE_HZ).tolist()
        before = after
    assert len(speeds_m_s) > 100
    assert np.mean(speeds_m_s) < 0.15


def test_marks_beside_joints_give_joints_centres(room: Simulation) -> None:
    """A detector that marks hips 5 cm outside; without its offsets they stay there."""
    offsets = {"hip": JointOffset(outwards=0.1)}
    hips = room.joints.indices(("left_hip", "right_hip"))
    errors_mm = {}
    for used in (offsets, MARKED_AT_CENTERS):
        capture = LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ, learn_s=1.0), used)
        instants = []
        for frame in range(50):
            marks_m = np.array(room.truth_m[:, frame])
            across_m = marks_m[:, hips[0]] - marks_m[:, hips[1]]
            across_m *= 0.05 / np.linalg.norm(across_m, axis=-1, keepdims=True)
            marks_m[:, hips[0]] += across_m
            marks_m[:, hips[1]] -= across_m
            for number, camera in enumerate(room.cameras):
                points_px = np.array([project(camera, person_m) for person_m in marks_m])
                score = np.where(np.isfinite(points_px).all(-1), 0.9, 0.0)
                instants += capture.push(number, frame / RATE_HZ, points_px, score)
        located_m = [person.xyz_m[hips] for person in instants[-1].people if person.skeleton is not None]
        truth_m = room.truth_m[:, len(instants) - 1][:, hips]
        assert len(located_m) == len(truth_m)
        off_m = [min(np.linalg.norm(each_m - true_m, axis=-1).mean() for true_m in truth_m) for each_m in located_m]
        errors_mm[bool(used)] = 1e3 * np.mean(off_m)
    assert errors_mm[True] < 15.0
    assert errors_mm[False] > 30.0


def test_skeleton_keeps_still_in_memory(room: Simulation) -> None:
    """Kept arrays are the same after learning, however long people stay."""
    capture = LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ, learn_s=1.0))
    kept = []
    for frame in sent_frames(room):
        capture.push(*frame)
        kept.append(capture.num_kept)
    assert max(kept) > 60
    # Of each of three people a second of positions is kept for the identity.
    assert max(kept[len(kept) // 4 :]) < 30 + 3 * 30


def test_heels_and_toes_that_stand_hardly_slide() -> None:
    """Without holding them they move at 0.25 m/s, by the detector's noise."""
    room = record(replace(SCENES["room"], duration_s=6.0), 1, joints="feet")
    instants = play(LiveCapture(room.cameras, room.joints, LiveSettings(RATE_HZ, learn_s=1.0)), sent_frames(room))
    for part in ("heel", "big_toe"):
        pair, speeds_m_s = room.joints.indices((f"left_{part}", f"right_{part}")), list[float]()
        for frame in range(50, len(instants)):
            before, after = (
                {person.id: person.xyz_m for person in instant.people if person.skeleton is not None}
                for instant in instants[frame - 1 : frame + 1]
            )
            for number in before.keys() & after.keys():
                apart_m = np.linalg.norm(room.truth_m[:, frame] - after[number], axis=-1)
                true_m = room.truth_m[int(np.nanargmin(np.nanmean(apart_m, axis=-1))), frame - 1 : frame + 1, pair]
                stands = np.linalg.norm(true_m[:, 1] - true_m[:, 0], axis=-1) * RATE_HZ < 0.02
                moved_m = np.linalg.norm(after[number][pair] - before[number][pair], axis=-1)
                speeds_m_s += (moved_m * RATE_HZ)[stands].tolist()
        assert len(speeds_m_s) > 100
        assert np.mean(speeds_m_s) < 0.15
