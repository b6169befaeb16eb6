"""Centre of mass, momentum and margin of stability by laws of mechanics, on bodies whose segments are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import savgol_filter
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from pipeline.core.data.animation import FootContact, SkeletonMotion
from pipeline.core.data.people import Source, Track3D
from pipeline.core.data.reconstruction import Subject
from pipeline.core.joints import BODY_FEET, COCO_17, JointSet
from pipeline.motion.angles.compute import segments_from
from pipeline.motion.balance import compute
from pipeline.motion.balance.compute import GRAVITY_M_S2, balance_of, margins_of, segment_centres
from pipeline.motion.balance.segment_masses import _TABLES, segment_masses
from pipeline.motion.skeleton.feet.floor import find_runs
from pipeline.motion.skeleton.model import SKELETON
from pipeline.validation.simulation.motion.performance import joints_at
from pipeline.validation.simulation.motion.script import Gesture
from tests.pipeline.motion.gait.walks import exercise, performed

RATE_HZ = 60.0
SUBJECTS = [Subject(table, sex) for table in ("de-leva", "dumas") for sex in ("female", "male", "unstated")]
# A person of 1.75 m who faces -y, as in the skeleton's rest pose, with hanging arms; left is +x.
STANDING_M = {
    "nose": (0.0, -0.09, 1.60),
    "eye": (0.03, -0.08, 1.63),
    "ear": (0.07, 0.0, 1.62),
    "shoulder": (0.18, 0.0, 1.43),
    "elbow": (0.22, 0.0, 1.13),
    "wrist": (0.24, 0.0, 0.87),
    "hip": (0.1, 0.0, 0.92),
    "knee": (0.1, 0.0, 0.50),
    "ankle": (0.1, 0.02, 0.09),
    "heel": (0.1, 0.07, 0.02),
    "big_toe": (0.1, -0.18, 0.02),
}


def standing_m(joints: JointSet) -> np.ndarray:
    places = []
    for name in joints.names:
        side, _, joint = name.rpartition("left_") if name.startswith("left_") else name.rpartition("right_")
        x, y, z = STANDING_M[joint]
        places.append((-x if side == "" and name.startswith("right_") else x, y, z))
    return np.array(places)


def rigid_flight(omega_rad_s: np.ndarray, start_m_s: np.ndarray, num_frames: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and shifts of a rigid body that flies and spins about its centre."""
    time_s = np.arange(num_frames) / RATE_HZ
    turns = Rotation.from_rotvec(time_s[:, None] * omega_rad_s).as_matrix()
    return turns, time_s[:, None] * start_m_s - [0.0, 0.0, 0.5] * (GRAVITY_M_S2 * time_s**2)[:, None]


def still(joints: JointSet, num_frames: int) -> tuple[SkeletonMotion, Track3D]:
    return person(np.tile(standing_m(joints), (num_frames, 1, 1)), joints, np.tile(np.eye(3), (num_frames, 1, 1)))


def person(
    xyz_m: np.ndarray, joints: JointSet, turns: np.ndarray, sigma_m: float | None = None
) -> tuple[SkeletonMotion, Track3D]:
    """Track of the joints, and a motion whose segments are all turned alike from the rest pose."""
    num_frames, num_joints = xyz_m.shape[:2]
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (num_frames, len(SKELETON), 1))
    rotations[:, 0] = Rotation.from_matrix(turns).as_quat()
    motion = SkeletonMotion(1, "", 3, RATE_HZ, np.full(len(SKELETON), 0.2), np.zeros((num_frames, 3)), rotations, ())
    zeros = np.zeros((num_frames, num_joints))
    uncertainty_m = None if sigma_m is None else np.full_like(zeros, sigma_m)
    source = np.full((num_frames, num_joints), Source.MEASURED)
    return motion, Track3D(1, 3, xyz_m, zeros + 1.0, source, zeros, source, uncertainty_m)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_shares_of_mass_sum_to_body(subject: Subject) -> None:
    masses = segment_masses(subject, BODY_FEET)
    assert masses is not None
    assert masses.mass.sum() == pytest.approx(1.0, abs=1e-12)
    assert masses.weights.sum() == pytest.approx(1.0, abs=1e-12)
    for sex in (0, 1):
        rows = _TABLES[subject.table]
        total = sum(row[sex][0] * (1 if name in {"head", "trunk", "pelvis"} else 2) for name, row in rows.items())
        assert total == pytest.approx(100.0, abs=0.25)


@pytest.mark.parametrize(
    ("subject", "lowest", "highest"),
    [
        (Subject("de-leva", "female"), 0.53, 0.58),
        (Subject("de-leva", "male"), 0.54, 0.60),
        (Subject("dumas", "male"), 0.54, 0.60),
    ],
)
def test_centre_of_standing_person_is_above_half_of_stature(subject: Subject, lowest: float, highest: float) -> None:
    """Women's centres are at 0.55 to 0.56 of stature, men's at 0.56 to 0.58."""
    motion, track = still(BODY_FEET, 9)
    found = balance_of(motion, track, BODY_FEET, subject)
    assert found is not None
    assert lowest < found.centre_m[4, 2] / 1.75 < highest
    assert abs(found.centre_m[4, 0]) < 1e-3
    np.testing.assert_allclose(found.momentum, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.angular_momentum, 0.0, atol=1e-9)


@pytest.mark.parametrize("subject", SUBJECTS)
@pytest.mark.parametrize("joints", [BODY_FEET, COCO_17], ids=["feet", "body"])
def test_flight_is_ballistic_and_spin_is_inertia_times_rate(subject: Subject, joints: JointSet) -> None:
    """A rigid body about a principal axis: momentum m v and angular momentum I omega, with I of points by hand."""
    rest_m = standing_m(joints)
    masses = segment_masses(subject, joints)
    assert masses is not None
    motion, _ = person(rest_m[None], joints, np.eye(3)[None])
    turns = np.stack([segments_from(motion)[name] for name in masses.orientations], axis=1)
    centres_m, length_m = segment_centres(masses, rest_m[None], turns)
    arms_m = centres_m[0] - masses.mass @ centres_m[0]
    inertia = np.zeros((3, 3))
    for share, arm_m, turn, radii in zip(
        masses.mass, arms_m, turns[0], masses.radii * length_m[0][:, None], strict=True
    ):
        inertia += share * (arm_m @ arm_m * np.eye(3) - np.outer(arm_m, arm_m) + turn @ np.diag(radii**2) @ turn.T)
    _, axes = np.linalg.eigh(inertia)
    for axis in axes.T:
        omega_rad_s, speed_m_s = 3.0 * axis, np.array([1.2, -0.7, 3.0])
        spins, shifts_m = rigid_flight(omega_rad_s, speed_m_s)
        middle_m = masses.mass @ centres_m[0]
        xyz_m = (rest_m - middle_m) @ np.swapaxes(spins, 1, 2) + middle_m + shifts_m[:, None]
        found = balance_of(*person(xyz_m, joints, spins), joints, replace_mass(subject))
        assert found is not None
        np.testing.assert_allclose(found.centre_m, middle_m + shifts_m, atol=1e-9)
        time_s = np.arange(len(shifts_m))[:, None] / RATE_HZ
        np.testing.assert_allclose(found.velocity_m_s, speed_m_s - time_s * [0.0, 0.0, GRAVITY_M_S2], atol=1e-9)
        acceleration = np.diff(found.velocity_m_s, axis=0) * RATE_HZ
        np.testing.assert_allclose(acceleration, np.tile([0.0, 0.0, -GRAVITY_M_S2], (60, 1)), atol=1e-6)
        np.testing.assert_allclose(found.momentum, 70.0 * found.velocity_m_s)
        expected = 70.0 * inertia @ omega_rad_s
        inner = found.angular_momentum[4:-4]
        # The filter sees arcs as parabolas: under a percent at 3 rad/s.
        np.testing.assert_allclose(
            inner, np.tile(expected, (len(inner), 1)), atol=0.01 * float(np.linalg.norm(expected))
        )


def replace_mass(subject: Subject) -> Subject:
    return subject._replace(mass_kg=70.0)


def test_deviation_is_deviation_of_repeated_noise() -> None:
    rng, num_frames = np.random.default_rng(4), 4000
    rest_m, sigma_m = standing_m(BODY_FEET), 0.01
    noisy_m = rest_m + rng.normal(size=(num_frames, *rest_m.shape)) * sigma_m
    motion, track = person(noisy_m, BODY_FEET, np.tile(np.eye(3), (num_frames, 1, 1)), sigma_m)
    contact = FootContact("left", 0, num_frames, 1.0, True, 0.0, 0.0)
    motion = replace(motion, contacts=(contact, replace(contact, side="right")))
    found = balance_of(motion, track, BODY_FEET, Subject())
    assert found is not None
    assert found.sigma_m[0] == pytest.approx(found.centre_m.std(0).mean(), rel=0.04)
    spread_m = found.extrapolated_m[8:-8].std(0).mean()
    assert found.margin_sigma_m[20] == pytest.approx(spread_m, rel=0.06)


def test_margin_is_distance_of_extrapolated_centre_from_feet() -> None:
    rest_m = standing_m(BODY_FEET)
    num_frames, speed_m_s = 31, 0.4
    shift_m = np.arange(num_frames)[:, None] / RATE_HZ * [0.0, -speed_m_s, 0.0]
    moving_m = rest_m + shift_m[:, None]
    feet = [number for number, name in enumerate(BODY_FEET.names) if name.endswith(("heel", "big_toe"))]
    moving_m[:, feet] = rest_m[feet]
    motion, track = person(moving_m, BODY_FEET, np.tile(np.eye(3), (num_frames, 1, 1)))
    left = FootContact("left", 5, 20, 1.0, True, 0.0, 0.0)
    motion = replace(motion, contacts=(left, replace(left, side="right", start_frame=10)))
    found = balance_of(motion, track, BODY_FEET, Subject("de-leva", "male"))
    assert found is not None
    assert np.isnan(found.margin_m[[0, 4, 30]]).all()
    # The feet reach from y = 0.07 to y = -0.18; with both, x is between -0.145 and 0.145.
    for row in range(10, 25):
        y = found.extrapolated_m[row, 1]
        assert found.margin_m[row] == pytest.approx(min(0.145, 0.07 - y, y + 0.18), abs=1e-6)
    # On the left foot alone, x = 0 is 0.055 m beside the foot.
    assert found.margin_m[6] == pytest.approx(-0.055, abs=1e-6)
    ankles_m = moving_m[15, BODY_FEET.indices(("left_ankle", "right_ankle"))].mean(0)
    lead_m = found.velocity_m_s[15, :2] * np.sqrt(np.linalg.norm(found.centre_m[15] - ankles_m) / GRAVITY_M_S2)
    np.testing.assert_allclose(found.extrapolated_m[15] - found.centre_m[15, :2], lead_m, rtol=1e-3, atol=1e-9)


def test_unknown_joint_leaves_only_its_frames_unknown() -> None:
    xyz_m = np.tile(standing_m(BODY_FEET), (20, 1, 1))
    xyz_m[7, BODY_FEET.index("left_knee")] = np.nan
    xyz_m[9, BODY_FEET.index("nose")] = np.nan
    motion, track = person(xyz_m, BODY_FEET, np.tile(np.eye(3), (20, 1, 1)))
    found = balance_of(motion, track, BODY_FEET, Subject())
    assert found is not None
    assert np.flatnonzero(np.isnan(found.centre_m).any(1)).tolist() == [7]
    assert np.flatnonzero(np.isnan(found.velocity_m_s).any(1)).tolist() == [7]


@pytest.mark.parametrize("num_frames", [1, 2, 4])
def test_short_track_has_a_centre(num_frames: int) -> None:
    motion, track = still(BODY_FEET, num_frames)
    found = balance_of(motion, track, BODY_FEET, Subject())
    assert found is not None
    assert np.isfinite(found.centre_m).all()
    assert np.isfinite(found.velocity_m_s).all() == (num_frames > 2)


def test_joints_without_legs_have_no_balance() -> None:
    arms = JointSet(tuple(name for name in COCO_17.names if "knee" not in name), ())
    motion, track = person(np.zeros((5, 15, 3)), arms, np.tile(np.eye(3), (5, 1, 1)))
    assert balance_of(motion, track, arms, Subject()) is None


def test_margin_is_distance_from_border_of_hull() -> None:
    rng = np.random.default_rng(2)
    corners_m = rng.normal(size=(200, 8, 2))
    corners_m[::2, 4:] = corners_m[::2, :4]
    points_m = rng.normal(size=(200, 2)) * 1.5
    found_m = margins_of(corners_m, points_m)
    for corners, point, margin_m in zip(corners_m, points_m, found_m, strict=True):
        border = corners[ConvexHull(corners).vertices]
        ring = np.linspace(border, np.roll(border, -1, axis=0), 2001).reshape(-1, 2)
        assert abs(margin_m) == pytest.approx(np.linalg.norm(ring - point, axis=1).min(), abs=2e-3)
        assert (margin_m >= 0) == (Delaunay(border).find_simplex(point) >= 0)


def test_blocks_of_frames_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    spins, shifts_m = rigid_flight(np.array([1.0, 2.0, -1.0]), np.array([1.0, 0.0, 3.0]))
    xyz_m = standing_m(BODY_FEET) @ np.swapaxes(spins, 1, 2) + shifts_m[:, None]
    whole = balance_of(*person(xyz_m, BODY_FEET, spins), BODY_FEET, Subject())
    monkeypatch.setattr(compute, "_BLOCK_FRAMES", 16)
    cut = balance_of(*person(xyz_m, BODY_FEET, spins), BODY_FEET, Subject())
    assert whole is not None
    assert cut is not None
    np.testing.assert_allclose(cut.centre_m, whole.centre_m, atol=1e-12)
    np.testing.assert_allclose(cut.angular_momentum, whole.angular_momentum, atol=1e-12)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_simulated_jump_flies_like_a_projectile(subject: Subject) -> None:
    """Flights of a countermovement jump: the centre falls by 9.81 m/s^2 and goes straight ahead."""
    act, rate_hz = exercise(Gesture.COUNTERMOVEMENT_JUMP, 2), 240.0
    joints_m = joints_at(performed(act), np.arange(0.0, act.duration_s, 1 / rate_hz))
    masses = segment_masses(subject, BODY_FEET)
    assert masses is not None
    centre_m = np.einsum("j,fjk->fk", masses.weights, joints_m)
    lowest_m = joints_m[:, BODY_FEET.indices(("left_big_toe", "right_big_toe")), 2].min(1)
    flights = [run for run in find_runs(lowest_m > lowest_m[:50].mean() + 0.05) if run[1] - run[0] > 40]
    assert len(flights) > 1
    for start, stop in flights:
        rows = slice(start + 8, stop - 8)
        time_s = np.arange(rows.stop - rows.start) / rate_hz
        fit = np.polynomial.Polynomial.fit(time_s, centre_m[rows, 2], 2).convert()
        assert 2 * fit.coef[2] == pytest.approx(-GRAVITY_M_S2, abs=0.06)
        for axis in (0, 1):
            line = np.polynomial.Polynomial.fit(time_s, centre_m[rows, axis], 1)
            np.testing.assert_allclose(line(time_s), centre_m[rows, axis], atol=1e-3)


@pytest.mark.parametrize(("num_frames", "window"), [(3, 3), (13, 13), (40, 7), (101, 15)])
def test_velocity_equals_filter_of_scipy(num_frames: int, window: int) -> None:
    values = np.random.default_rng(num_frames).normal(size=(num_frames, 3)).cumsum(0)
    expected = savgol_filter(values, window, 2, deriv=1, delta=1.0 / RATE_HZ, axis=0)
    np.testing.assert_array_equal(compute._velocity(values, window, RATE_HZ), expected)


@pytest.mark.parametrize("subject", SUBJECTS)
def test_head_without_ears_and_feet_without_heels_are_estimated(subject: Subject) -> None:
    """Marker sets and Human3.6M's points have no ears: the centre of a standing person stays where it was."""
    motion, track = still(BODY_FEET, 9)
    expected = balance_of(motion, track, BODY_FEET, subject)
    lacking = track.xyz_m.copy()
    lacking[:, BODY_FEET.indices(("left_ear", "right_ear", "left_heel", "right_heel"))] = np.nan
    balance = balance_of(motion, replace(track, xyz_m=lacking), BODY_FEET, subject)
    assert expected is not None
    assert balance is not None
    assert np.linalg.norm(balance.centre_m - expected.centre_m, axis=-1).max() < 0.004


def test_balance_without_wrist_is_unknown() -> None:
    motion, track = still(BODY_FEET, 9)
    lacking = track.xyz_m.copy()
    lacking[:, BODY_FEET.index("left_wrist")] = np.nan
    balance = balance_of(motion, replace(track, xyz_m=lacking), BODY_FEET, SUBJECTS[0])
    assert balance is not None
    assert np.isnan(balance.centre_m).all()
