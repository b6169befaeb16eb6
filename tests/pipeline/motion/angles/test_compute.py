"""Angles of fitted people: against exact ones, with standard deviations, and unknown where nothing shows them."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from pipeline.core.data.cameras import Timebase
from pipeline.core.data.people import Source
from pipeline.core.joints import BODY_FEET, COCO_17, WHOLE_BODY
from pipeline.core.options.config import ReconstructionConfig
from pipeline.motion.angles import compute
from pipeline.motion.angles.compute import (
    NUM_POINTS,
    JointAngles,
    joint_angles,
    normalised_cycles,
    ranges_of_motion,
    segment_angles,
    segments_from,
)
from pipeline.motion.body_segments import ANGLE_NAMES, SEGMENTS
from pipeline.motion.skeleton.animate import animate
from tests.cases import accuracy_but
from tests.pipeline.motion.angles.simulated_people import NOISE_PX, RATE_HZ, errors_deg, fitted, performed, rmse_deg
from tests.pipeline.motion.skeleton.observed import observe, ring_of
from tests.pipeline.motion.skeleton.synthetic_tracks import track_of, walker
from tests.pipeline.motion.test_body_segments import posed

HINGES = ("knee_flexion", "elbow_flexion", "ankle_dorsiflexion")
BALLS = ("hip_flexion", "hip_adduction", "shoulder_flexion", "shoulder_adduction", "shoulder_elevation")
TWISTS = ("hip_rotation", "shoulder_rotation", "shoulder_axial", "ankle_rotation", "trunk_rotation", "neck_rotation")


def columns(*names: str) -> list[int]:
    return [ANGLE_NAMES.index(name) for name in names]


def test_angles_of_walk_are_those_of_truth() -> None:
    truth_deg, angles = fitted("walk", 6, seed=7, duration_s=2.5)
    errors = errors_deg(truth_deg, angles)
    assert {name: rmse_deg(errors[name]) for name in HINGES if rmse_deg(errors[name]) > 3.0} == {}
    assert {name: rmse_deg(errors[name]) for name in BALLS if rmse_deg(errors[name]) > 4.0} == {}
    assert {name: rmse_deg(errors[name]) for name in TWISTS if rmse_deg(errors[name]) > 8.0} == {}
    # Knees bend by more in each stride: an angle that is always the mean would be far off.
    knees = columns("left_knee_flexion", "right_knee_flexion")
    assert np.ptp(truth_deg[:, knees], axis=0).min() > 30.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "num_cameras", "seeds"),
    [
        ("walk", 3, (1,)),
        ("squat", 6, (1,)),
        ("kick", 4, (1,)),
        *accuracy_but([], product(("walk", "squat", "kick"), (6, 4, 3), [(1, 2, 3, 4)])),
    ],
)
def test_angles_are_as_precise_as_documented(motion: str, num_cameras: int, seeds: tuple[int, ...]) -> None:
    of_seeds = [errors_deg(*fitted(motion, num_cameras, seed)) for seed in seeds]
    errors = {name: np.concatenate([of_seed[name] for of_seed in of_seeds]) for name in of_seeds[0]}
    few = {6: 1.0, 4: 1.25, 3: 1.5}[num_cameras]
    for name in HINGES:
        assert rmse_deg(errors[name]) < 3.0 * few, name
    for name in BALLS:
        # How a squatting trunk shares its bend is not seen, by however many cameras: docs/lab/angles.md.
        limit_deg = 6.2 if motion == "squat" and name == "hip_flexion" else 4.0 * few
        assert rmse_deg(errors[name]) < limit_deg, name
    for name in TWISTS:
        assert rmse_deg(errors[name]) < 8.0 * few, name


def test_standard_deviations_are_those_of_errors() -> None:
    truth_deg, angles = fitted("walk", 6, seed=7, duration_s=2.5)
    for name in ("left_knee_flexion", "right_elbow_flexion", "left_hip_adduction", "pelvis_rotation"):
        (column,) = columns(name)
        error_deg = angles.angle_deg[:, column] - truth_deg[:, column]
        ratio = rmse_deg(error_deg / angles.sigma_deg[:, column])
        assert 0.35 < ratio < 1.6, (name, ratio)
    assert (np.isfinite(angles.sigma_deg) == np.isfinite(angles.angle_deg)).all()


def test_straight_limb_has_bend_but_no_twist() -> None:
    xyz_m = walker(20, elbow_rad=lambda phase: np.full_like(phase, 0.05))
    track = track_of(xyz_m)
    angles = joint_angles(replace(posed({}), root_m=np.zeros((20, 3)), parent_from_joint=np.tile(
        posed({"LeftArm": np.array([0.0, 40.0, 0.0])}).parent_from_joint, (20, 1, 1))), track, COCO_17)  # fmt: skip
    known = np.isfinite(angles.angle_deg)
    assert not known[:, columns("left_shoulder_rotation", "left_shoulder_axial")].any()
    assert known[:, columns("left_shoulder_flexion", "left_shoulder_elevation", "left_elbow_flexion")].all()


def test_without_heels_and_fingers_feet_and_hands_have_no_angles() -> None:
    joints_m, _ = performed("walk", 7, 0.5)
    cameras = ring_of(4)
    track, seen = observe(cameras, joints_m[:, : len(COCO_17.names)], noise_px=NOISE_PX)
    timebase = Timebase(0.0, RATE_HZ, len(joints_m))
    animation = animate([track], [seen], cameras, timebase, COCO_17, ReconstructionConfig())
    angles = joint_angles(animation.motions[0], animation.tracks[0], COCO_17)
    unknown = {name for name, column in zip(ANGLE_NAMES, angles.angle_deg.T, strict=True) if np.isnan(column).all()}
    kinds = ("ankle_dorsiflexion", "subtalar_inversion", "ankle_rotation", "forearm_pronation", "wrist_flexion",
             "wrist_deviation")  # fmt: skip
    assert unknown == {f"{side}_{kind}" for side in ("left", "right") for kind in kinds}


def test_gaps_are_unknown_for_joints_that_they_concern() -> None:
    turns = np.tile(posed({}).parent_from_joint, (10, 1, 1))
    motion = replace(posed({}), root_m=np.zeros((10, 3)), parent_from_joint=turns)
    xyz_m = walker(10)
    xyz_m[3:6, COCO_17.index("left_knee")] = np.nan
    angles = joint_angles(motion, track_of(xyz_m), COCO_17)
    known = np.isfinite(angles.angle_deg)
    gap = np.zeros(10, bool)
    gap[3:6] = True
    for name in ("left_knee_flexion", "left_hip_flexion", "left_hip_adduction"):
        np.testing.assert_array_equal(known[:, columns(name)[0]], ~gap)
    assert known[:, columns("right_knee_flexion", "pelvis_tilt", "left_elbow_flexion")].all()
    # A smoothing other than the fit states no uncertainty.
    assert np.isnan(angles.sigma_deg).all()
    # Nobody at all.
    nowhere = joint_angles(motion, track_of(np.full_like(xyz_m, np.nan)), COCO_17)
    assert np.isnan(nowhere.angle_deg).all()


def test_hands_that_nobody_saw_have_no_angles() -> None:
    turns = np.tile(posed({}).parent_from_joint, (4, 1, 1))
    motion = replace(posed({}), root_m=np.zeros((4, 3)), parent_from_joint=turns)
    bent_m = walker(4)
    rng = np.random.default_rng(0)
    wrists = [bent_m[:, [COCO_17.index(f"{side}_wrist")]] for side in ("left", "right")]
    count = (len(WHOLE_BODY.names) - len(BODY_FEET.names)) // 2
    feet_m = bent_m[:, [COCO_17.index("left_ankle")] * 4] + rng.normal(0.0, 0.1, (1, 4, 3))
    fingers_m = [wrist_m + rng.normal(0.0, 0.05, (1, count, 3)) for wrist_m in wrists]
    track = track_of(np.concatenate([bent_m, feet_m, *fingers_m], axis=1))
    source = np.full_like(track.source, Source.MEASURED)
    source[:, WHOLE_BODY.indices(("left_middle_mcp", "left_index_mcp", "left_pinky_mcp"))] = Source.PREDICTED
    angles = joint_angles(motion, replace(track, source=source), WHOLE_BODY)
    known = np.isfinite(angles.angle_deg).all(0)
    assert known[columns("right_wrist_flexion", "right_wrist_deviation", "right_forearm_pronation")].all()
    assert not known[columns("left_wrist_flexion", "left_wrist_deviation", "left_forearm_pronation")].any()


def test_missing_segment_leaves_out_its_joints_alone() -> None:
    segments = {name: turns for name, turns in segments_from(posed({})).items() if not name.endswith("foot")}
    found = dict(zip(ANGLE_NAMES, segment_angles(segments)[0], strict=True))
    assert np.isnan(found["left_ankle_dorsiflexion"])
    assert found["left_knee_flexion"] == pytest.approx(0.0)
    assert len(segments) == len(SEGMENTS) - 2


def test_long_takes_are_worked_on_in_blocks_with_same_angles(monkeypatch: pytest.MonkeyPatch) -> None:
    joints_m, _ = performed("walk", 7, 0.5)
    track = track_of(joints_m)
    track = replace(track, uncertainty_m=np.full(track.score.shape, 0.005))
    turns = np.tile(posed({}).parent_from_joint, (len(joints_m), 1, 1))
    motion = replace(posed({}), root_m=np.zeros((len(joints_m), 3)), parent_from_joint=turns)
    whole = joint_angles(motion, track, BODY_FEET)
    monkeypatch.setattr(compute, "_BLOCK_FRAMES", 7)
    cut = joint_angles(motion, track, BODY_FEET)
    np.testing.assert_array_equal(cut.angle_deg, whole.angle_deg)
    np.testing.assert_array_equal(cut.sigma_deg, whole.sigma_deg)
    assert np.isfinite(whole.sigma_deg[:, columns("left_knee_flexion")]).all()


def test_ranges_of_motion_are_those_of_known_frames() -> None:
    angle_deg = np.full((5, len(ANGLE_NAMES)), np.nan)
    sigma_deg = angle_deg.copy()
    knee, elbow = columns("left_knee_flexion", "right_elbow_flexion")
    angle_deg[1:4, knee], sigma_deg[1:4, knee] = [10.0, 64.5, 30.0], [1.0, 2.0, 4.0]
    angle_deg[2, elbow] = 20.0
    assert ranges_of_motion(JointAngles(0, angle_deg, sigma_deg)) == {
        "left_knee_flexion": {
            "min_deg": 10.0, "max_deg": 64.5, "range_deg": 54.5, "num_frames": 3, "sigma_deg": 2.0
        },
        "right_elbow_flexion": {
            "min_deg": 20.0, "max_deg": 20.0, "range_deg": 0.0, "num_frames": 1, "sigma_deg": None
        },
    }  # fmt: skip


def test_cycles_of_different_lengths_have_same_percents() -> None:
    # An angle that goes from 0 to 60 and back in each cycle, one of 40 frames and one of 25.5.
    rows = np.arange(80)
    phase = np.where(rows < 45, (rows - 5.0) / 40.0, (rows - 45.0) / 25.5)
    angle_deg = 30.0 - 30.0 * np.cos(2 * np.pi * phase)
    found = normalised_cycles(angle_deg, [(5.0, 45.0), (45.0, 70.5)])
    assert found.shape == (2, NUM_POINTS)
    expected = 30.0 - 30.0 * np.cos(2 * np.pi * np.linspace(0.0, 1.0, NUM_POINTS))
    np.testing.assert_allclose(found, [expected, expected], atol=0.5)


def test_cycles_with_unknown_angles_are_left_out() -> None:
    angle_deg = np.arange(50.0)
    angle_deg[20] = np.nan
    cycles = [
        (0.0, 10.0),
        (12.5, 19.0),
        (12.5, 19.2),
        (15.0, 30.0),
        (40.0, 49.0),
        (45.0, 49.5),
        (-1.0, 5.0),
        (9.0, 9.0),
    ]
    found = normalised_cycles(angle_deg, cycles)
    np.testing.assert_allclose(found[:, [0, -1]], [[0.0, 10.0], [12.5, 19.0], [40.0, 49.0]])
    assert normalised_cycles(angle_deg, []).shape == (0, NUM_POINTS)
