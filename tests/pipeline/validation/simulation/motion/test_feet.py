"""Simulated feet: rigid, on the floor, rolling from heel to toes in walking and level in standing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.core.joints import BODY_FEET
from pipeline.validation.simulation.motion.performance import SimulatedPerson, joints_at, perform
from pipeline.validation.simulation.motion.script import Cue, Gesture, Role, Stay, Turn, Walk

HEELS, TOES, ANKLES = (BODY_FEET.indices((f"left_{part}", f"right_{part}")) for part in ("heel", "big_toe", "ankle"))
RATE_HZ = 200.0


def act(*cues: Cue, duration_s: float = 5.0, seed: int = 1) -> SimulatedPerson:
    return perform(Role((0.0, 0.0), 0.0, cues), duration_s, np.random.default_rng(seed), BODY_FEET)


def joints_m(person: SimulatedPerson, duration_s: float = 5.0) -> np.ndarray:
    return joints_at(person, np.arange(0.0, duration_s, 1 / RATE_HZ))


def pitch_deg(points_m: np.ndarray) -> np.ndarray:
    """Angle of the soles to the floor, positive with the heel above the toes."""
    along_m = points_m[:, TOES] - points_m[:, HEELS]
    return np.degrees(np.arctan2(-along_m[..., 2], np.linalg.norm(along_m[..., :2], axis=-1)))


@settings(max_examples=15, deadline=None)
@given(
    gesture=st.sampled_from(Gesture),
    seed=st.integers(0, 100),
    to_m=st.tuples(st.floats(-3, 3), st.floats(-3, 3)).filter(lambda place: np.hypot(*place) > 0.5),
    speed=st.floats(0.8, 3.5),
)
def test_feet_are_rigid_and_never_below_floor(
    gesture: Gesture, seed: int, to_m: tuple[float, float], speed: float
) -> None:
    person = act(Stay(2.0, gesture), Walk(to_m, speed), Turn(2.0), duration_s=6.0, seed=seed)
    points_m = joints_m(person, 6.0)
    feet_m = points_m[:, [ANKLES, HEELS, TOES]]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert np.ptp(np.linalg.norm(feet_m[:, first] - feet_m[:, second], axis=-1), axis=0).max() < 1e-9
    assert feet_m[..., 2].min() > -1e-6
    # The knees still reach the ankles of rolling feet.
    shin_m = np.linalg.norm(points_m[:, BODY_FEET.index("left_knee")] - points_m[:, ANKLES[0]], axis=-1)
    assert np.ptp(shin_m) < 1e-9


def test_standing_feet_are_level_and_turned_outwards() -> None:
    points_m = joints_m(act(Stay(5.0, Gesture.TALK)))
    np.testing.assert_allclose(points_m[:, [*HEELS, *TOES], 2], 0.0, atol=1e-6)
    assert np.ptp(points_m[:, [*HEELS, *TOES]], axis=0).max() < 1e-6
    ahead_m = points_m[0, TOES] - points_m[0, HEELS]
    heading_deg = np.degrees(np.arctan2(ahead_m[:, 1], ahead_m[:, 0]))
    # Feet are turned outwards by 3 to 12 degrees; the big toe lies inwards of the foot's axis by some 4 degrees.
    assert -2.0 < heading_deg[0] < 9.0
    assert heading_deg[0] == pytest.approx(-heading_deg[1])
    assert 0.19 < np.linalg.norm(ahead_m[0]) < 0.28


def test_walking_feet_roll_from_heel_to_toes() -> None:
    points_m = joints_m(act(Walk((5.0, 0.0))))
    pitch = pitch_deg(points_m)
    heel_down, toe_down = (points_m[:, joints, 2] < 1e-4 for joints in (HEELS, TOES))
    for foot in (0, 1):
        landing = heel_down[:, foot] & ~toe_down[:, foot]
        push = toe_down[:, foot] & ~heel_down[:, foot]
        level = toe_down[:, foot] & heel_down[:, foot]
        assert pitch[landing, foot].min() < -15.0
        assert pitch[push, foot].max() > 25.0
        assert np.abs(pitch[level, foot]).max() < 0.2
        # Landing, level, push: in this order in each stance.
        phases = np.select([landing, level, push], [1, 2, 3])
        order = phases[phases > 0][np.flatnonzero(np.diff(phases[phases > 0], prepend=0))].tolist()
        assert [1, 2, 3] in [order[k : k + 3] for k in range(len(order) - 2)]
        assert order.count(1) >= 2


@pytest.mark.parametrize("joints", [HEELS, TOES])
def test_point_on_which_foot_rolls_stays_in_place(joints: list[int]) -> None:
    points_m = joints_m(act(Walk((5.0, 0.0))))[:, joints]
    down = points_m[..., 2] < 1e-5
    speed_m_s = np.linalg.norm(np.diff(points_m[..., :2], axis=0), axis=-1) * RATE_HZ
    # Only rows between two rows on the floor: a foot swings from the next one on.
    inside = down[:-3] & down[1:-2] & down[2:-1] & down[3:]
    assert speed_m_s[1:-1][inside].max() < 0.02
    assert inside.any(0).all()


def test_feet_do_not_change_rest_of_body() -> None:
    role = Role((0.0, 0.0), 0.0, (Walk((3.0, 1.0)), Stay(3.0, Gesture.JUMP)))
    time_s = np.arange(0.0, 6.0, 0.05)
    plain, rolling = (
        joints_at(perform(role, 6.0, np.random.default_rng(3), *joints), time_s) for joints in ((), (BODY_FEET,))
    )
    np.testing.assert_array_equal(rolling[:, :13], plain[:, :13])
    assert 0.03 < np.abs(rolling[:, ANKLES] - plain[:, ANKLES]).max() < 0.12


def test_toes_hang_in_air_of_jump() -> None:
    points_m = joints_m(act(Stay(4.0, Gesture.JUMP)))
    toes_m = points_m[:, TOES, 2]
    assert 0.12 < toes_m.max() < 0.4
    assert pitch_deg(points_m)[toes_m[:, 0].argmax(), 0] > 20.0
