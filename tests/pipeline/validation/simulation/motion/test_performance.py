"""Simulated motion: constant bones, feet on the floor, and speeds of gestures."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.joints import COCO_17, LIMBS
from pipeline.validation.simulation.motion.performance import SimulatedPerson, joints_at, perform
from pipeline.validation.simulation.motion.script import Away, Cue, Gesture, Role, Stay, Turn, Walk

RIGID = (
    *LIMBS,
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("left_ear", "right_ear"),
    ("nose", "left_eye"),
    ("nose", "right_ear"),
)
ANKLES = COCO_17.indices(("left_ankle", "right_ankle"))
WRISTS = COCO_17.indices(("left_wrist", "right_wrist"))
HIPS = COCO_17.indices(("left_hip", "right_hip"))


def act(*cues: Cue, duration_s: float = 5.0, seed: int = 1) -> SimulatedPerson:
    return perform(Role((0.0, 0.0), 0.0, cues), duration_s, np.random.default_rng(seed))


def instants(duration_s: float = 5.0, rate_hz: float = 100.0) -> np.ndarray:
    return np.arange(0.0, duration_s, 1 / rate_hz)


def speed_m_s(path_m: np.ndarray, rate_hz: float = 100.0) -> np.ndarray:
    return np.linalg.norm(np.diff(path_m, axis=0), axis=-1) * rate_hz


@settings(max_examples=15, deadline=None)
@given(
    gesture=st.sampled_from(Gesture),
    seed=st.integers(0, 100),
    to_m=st.tuples(st.floats(-3, 3), st.floats(-3, 3)).filter(lambda place: np.hypot(*place) > 0.5),
    speed=st.floats(0.8, 2.0),
)
def test_bones_keep_their_length(gesture: Gesture, seed: int, to_m: tuple[float, float], speed: float) -> None:
    person = act(Stay(2.0, gesture), Walk(to_m, speed), Turn(2.0), duration_s=6.0, seed=seed)
    joints_m = joints_at(person, np.linspace(0.0, 6.0, 250))
    for first, second in RIGID:
        bone_m = np.linalg.norm(joints_m[:, COCO_17.index(first)] - joints_m[:, COCO_17.index(second)], axis=-1)
        assert np.ptp(bone_m) < 1e-9, (first, second)
    forearm_m = joints_m[0, COCO_17.index("left_elbow")] - joints_m[0, COCO_17.index("left_wrist")]
    assert np.linalg.norm(forearm_m) == pytest.approx(person.body.forearm_m)


@pytest.mark.parametrize("gesture", [g for g in Gesture if not g.value.endswith("jump")])
def test_feet_stand_while_somebody_stays(gesture: Gesture) -> None:
    person = act(Walk((2.0, 1.0)), Stay(4.0, gesture), duration_s=9.0)
    ankles_m = joints_at(person, np.arange(4.5, 7.5, 0.02))[:, ANKLES]
    np.testing.assert_allclose(ankles_m[..., 2], person.body.ankle_height_m, atol=1e-6)
    np.testing.assert_allclose(ankles_m, np.broadcast_to(ankles_m[0], ankles_m.shape), atol=1e-6)
    feet_m = np.linalg.norm(ankles_m[0, 0] - ankles_m[0, 1])
    assert 0.1 < feet_m < 0.5


def test_foot_stands_through_its_stance() -> None:
    """In walking one foot is always on the floor, and a foot on the floor does not slide."""
    person = act(Walk((5.0, 0.0)), duration_s=5.0)
    ankles_m = joints_at(person, instants())[:, ANKLES]
    down = ankles_m[..., 2] < person.body.ankle_height_m + 1e-4
    assert down.any(1).all()
    assert ankles_m[..., 2].min() > person.body.ankle_height_m - 1e-6
    moved_m_s = speed_m_s(ankles_m)
    assert moved_m_s[(down[1:] & down[:-1])].max() < 0.05
    assert moved_m_s.max() > 2.0


def test_walking_leads_to_place_at_pace() -> None:
    joints_m = joints_at(act(Walk((3.0, 1.0), 1.2)), instants())
    hips_m = joints_m[:, HIPS].mean(1)
    np.testing.assert_allclose(hips_m[-1, :2], [3.0, 1.0], atol=0.06)
    assert 1.1 < speed_m_s(hips_m).max() < 2.2
    # Upright all the way, and never sunk between two steps.
    assert hips_m[:, 2].min() > 0.9 * hips_m[0, 2]


def test_arms_swing_against_legs() -> None:
    joints_m = joints_at(act(Walk((6.0, 0.0)), duration_s=6.0), instants(4.0))[150:350, :, 0]
    hips, left_wrist, left_ankle = joints_m[:, HIPS].mean(1), joints_m[:, WRISTS[0]], joints_m[:, ANKLES[0]]
    assert np.corrcoef(left_wrist - hips, left_ankle - hips)[0, 1] < -0.8


def test_people_face_where_they_turn() -> None:
    joints_m = joints_at(act(Turn(np.pi / 2)), np.array([4.5]))[0]
    left = joints_m[HIPS[0]] - joints_m[HIPS[1]]
    np.testing.assert_allclose(left[:2] / np.linalg.norm(left), [-1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("gesture", "slowest", "fastest"),
    [
        (Gesture.IDLE, 0.0, 0.3),
        (Gesture.TALK, 0.3, 3.0),
        (Gesture.PUNCH, 5.0, 9.0),
        (Gesture.SWING, 5.0, 9.0),
        (Gesture.CROUCH, 0.3, 2.5),
    ],
)
def test_wrists_are_as_fast_as_gesture(gesture: Gesture, slowest: float, fastest: float) -> None:
    wrists_m = joints_at(act(Stay(4.0, gesture)), instants())[:, WRISTS]
    assert slowest < speed_m_s(wrists_m).max() < fastest


def test_jumps_leave_floor_and_fall_freely() -> None:
    person = act(Stay(4.0, Gesture.JUMP))
    height_m = joints_at(person, instants())[:, ANKLES[0], 2] - person.body.ankle_height_m
    assert 0.12 < height_m.max() < 0.4
    assert abs(height_m[-1]) < 1e-6
    top = int(height_m.argmax())
    assert np.diff(height_m, 2)[top - 1] * 100**2 == pytest.approx(-9.81, abs=0.5)


def test_crouching_lowers_hips() -> None:
    hips_m = joints_at(act(Stay(4.0, Gesture.CROUCH)), instants())[:, HIPS, 2].mean(1)
    assert 0.4 * hips_m[0] < hips_m.min() < 0.75 * hips_m[0]
    assert hips_m[-1] == pytest.approx(hips_m[0], abs=0.01)


def test_hands_meet() -> None:
    meeting = (0.38, 0.0, 1.02)
    left = perform(Role((0.0, 0.0), 0.0, (Stay(4.0, Gesture.SHAKE_HANDS, meeting),)), 4.0, np.random.default_rng(1))
    right = perform(Role((0.76, 0.0), np.pi, (Stay(4.0, Gesture.SHAKE_HANDS, meeting),)), 4.0, np.random.default_rng(2))
    hands_m = [joints_at(person, np.array([2.0]))[0, WRISTS[1]] for person in (left, right)]
    assert np.linalg.norm(hands_m[0] - hands_m[1]) < 0.15
    np.testing.assert_allclose(np.mean(hands_m, axis=0), meeting, atol=0.1)


def test_absent_person_has_no_position() -> None:
    person = act(Stay(1.0), Away(2.0, (3.0, 3.0), 0.0), duration_s=5.0)
    joints_m = joints_at(person, np.array([0.9, 1.1, 2.9, 3.1, 4.9]))
    np.testing.assert_array_equal(np.isnan(joints_m).all((1, 2)), [False, True, True, False, False])
    np.testing.assert_allclose(joints_m[3, HIPS, :2].mean(0), [3.0, 3.0], atol=0.1)


def test_motion_does_not_depend_on_when_it_is_looked_at() -> None:
    person = act(Walk((3.0, 0.0)), Stay(2.0, Gesture.PUNCH))
    all_at_once = joints_at(person, instants())
    np.testing.assert_array_equal(joints_at(person, instants()[[17, 203, 391]]), all_at_once[[17, 203, 391]])


def test_people_differ() -> None:
    statures_m = [act(seed=seed).body.stature_m for seed in range(20)]
    assert min(statures_m) >= 1.5
    assert max(statures_m) <= 1.95
    assert np.std(statures_m) > 0.05
