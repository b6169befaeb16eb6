"""Foot strikes, foot offs and strides of simulated walks, against the exact truth."""

import numpy as np
import pytest

from pipeline.core.joints import BODY_FEET, SIDES
from pipeline.motion.gait.analysis import analyse_gait
from pipeline.motion.gait.events import EventKind
from pipeline.motion.gait.strides import Stride
from pipeline.validation.simulation.motion.performance import joints_at
from pipeline.validation.simulation.motion.script import Gesture, Stay, Turn, Walk
from tests.acrobatics.acrobat import acrobat_joints_at, perform_acrobatics
from tests.acrobatics.motions import ACROBATICS
from tests.cases import slow_but
from tests.pipeline.motion.gait.walks import Act, body_only, exact, gait_of, performed, treadmill, walk
from tests.pipeline.validation.simulation.true_events import step_times

SPEEDS_M_S = (0.8, 1.2, 1.6)
# Speed, person, number of cameras and rate of treadmills that were not used in development.
OTHER_BELTS = [(0.8, 31, 4, 60.0), (1.6, 32, 5, 60.0), (1.6, 33, 3, 60.0), (1.6, 34, 4, 30.0), (1.2, 35, 8, 100.0)]
FRAME_S = 1 / 60
# A check beside the walks above: other bodies, cadences, noise, rates and numbers of cameras.
OTHERS = [walk(0.6, 21, 60.0, 4), walk(1.0, 22, 50.0, 3), walk(1.4, 23, 100.0, 8), walk(1.9, 24, 60.0, 5)]


def errors_s(act: Act, kind: EventKind) -> np.ndarray:
    """Differences from the true events of each foot to the found ones, but for the first and the last of the walk.

    A walk begins and ends with a slow half of a step, which has no corner.
    """
    found, errors = gait_of(act).events, []
    for foot, side in enumerate(SIDES):
        times = step_times(performed(act))[foot]
        true_s = times.strikes_s if kind == "foot_strike" else times.offs_s
        found_s = np.array([event.row / act.rate_hz for event in found if (event.side, event.kind) == (side, kind)])
        errors += [found_s[np.abs(found_s - time_s).argmin()] - time_s for time_s in true_s[1:-1]]
    return np.array(errors)


def length_errors_m(act: Act) -> np.ndarray:
    """Errors of the lengths of strides: true footprints are those of the true heel shortly after the strike."""
    first_row = 0 if act.rows is None else act.rows[0]
    errors = []
    for stride in gait_of(act).strides:
        time_s = (np.array([stride.strike_row, stride.next_row]) + first_row) / act.rate_hz + 0.1
        true_m = joints_at(performed(act), time_s)[:, BODY_FEET.index(f"{stride.side}_heel"), :2]
        errors.append(stride.length_m - np.linalg.norm(true_m[1] - true_m[0]))
    return np.array(errors)


def true_cadence(act: Act) -> float:
    """Mean cadence of the counted strides by their true foot strikes."""
    times = dict(zip(SIDES, step_times(performed(act)), strict=True))

    def nearest_s(side: str, row: float) -> float:
        strikes_s = times[side].strikes_s
        return float(strikes_s[np.abs(strikes_s - row / act.rate_hz).argmin()])

    def duration_s(stride: Stride) -> float:
        return nearest_s(stride.side, stride.next_row) - nearest_s(stride.side, stride.strike_row)

    return float(np.mean([120 / duration_s(stride) for stride in gait_of(act).strides if stride.is_steady]))


@pytest.mark.parametrize("speed_m_s", SPEEDS_M_S)
def test_events_of_exact_walks_lie_between_frames(speed_m_s: float) -> None:
    for kind in ("foot_strike", "foot_off"):
        assert np.abs(errors_s(walk(speed_m_s), kind)).max() < 0.2 * FRAME_S
    assert np.abs(length_errors_m(walk(speed_m_s))).max() < 0.001


@pytest.mark.parametrize("speed_m_s", slow_but([1.2], SPEEDS_M_S))
def test_fitted_walks_have_events_strides_and_cadence(speed_m_s: float) -> None:
    act = walk(speed_m_s, seed=11, num_cameras=6)
    for kind in ("foot_strike", "foot_off"):
        assert np.abs(errors_s(act, kind)).max() < FRAME_S
    assert np.abs(length_errors_m(act)).max() < 0.01
    figures = gait_of(act).figures
    assert figures is not None
    assert figures.both["cadence_steps_per_min"].mean == pytest.approx(true_cadence(act), rel=0.01)
    assert figures.both["stance_percent"].mean == pytest.approx(60.0, abs=2.0)
    assert figures.both["double_support_percent"].mean == pytest.approx(20.0, abs=3.0)
    assert figures.confidence > 0.9
    assert not figures.is_running


@pytest.mark.slow
@pytest.mark.parametrize("act", OTHERS)
def test_other_bodies_cameras_and_rates(act: Act) -> None:
    for kind in ("foot_strike", "foot_off"):
        assert np.sqrt(np.mean(errors_s(act, kind) ** 2)) < FRAME_S
    assert np.abs(length_errors_m(act)).max() < 0.01
    figures = gait_of(act).figures
    assert figures is not None
    assert figures.both["cadence_steps_per_min"].mean == pytest.approx(true_cadence(act), rel=0.01)


def test_steps_divide_stride_and_feet_are_apart() -> None:
    act = walk(1.2)
    for stride in gait_of(act).strides:
        before_m, after_m = (
            joints_at(performed(act), np.array([row / act.rate_hz + 0.1]))[0, BODY_FEET.index(f"{side}_heel"), :2]
            for row, side in (
                (stride.strike_row, stride.side),
                (stride.other_strike_row, "right" if stride.side == "left" else "left"),
            )
        )
        apart_m = np.linalg.norm(after_m - before_m)
        first_step_m = stride.length_m - stride.step_length_m
        assert np.hypot(first_step_m, stride.width_m) == pytest.approx(apart_m, abs=0.002)
        assert stride.stance_s + stride.swing_s == pytest.approx(stride.duration_s)


def test_walk_of_ankles_alone_is_told_with_less_confidence() -> None:
    act = body_only(walk(1.2))
    gait = gait_of(act)
    assert not gait.has_marks
    assert len(gait.strides) == len(gait_of(walk(1.2)).strides)
    assert max(event.confidence for event in gait.events) < 0.92
    assert np.abs(length_errors_m(walk(1.2))).max() < 0.01


def test_runs_have_flight_and_no_double_support() -> None:
    act = Act((Walk((6.0, 0.0), 3.2),), (-6.0, 0.0), duration_s=5.5, seed=3)
    figures = gait_of(act).figures
    assert figures is not None
    assert figures.is_running
    assert figures.both["double_support_percent"].mean == 0.0
    assert figures.both["stance_percent"].mean == pytest.approx(35.0, abs=2.0)
    assert not gait_of(act).movements


@pytest.mark.parametrize("num_cameras", slow_but([0], [0, 6]))
def test_strides_on_treadmill_are_those_on_its_belt(num_cameras: int) -> None:
    act, belt_m_s = treadmill(1.2, seed=6, num_cameras=num_cameras)
    gait = gait_of(act)
    assert gait.belt_m_s == pytest.approx(belt_m_s, rel=0.01)
    assert len(gait.strides) >= 15
    assert np.abs(length_errors_m(act)).max() < (0.01 if num_cameras else 0.002)


@pytest.mark.slow
@pytest.mark.parametrize(("speed_m_s", "seed", "num_cameras", "rate_hz"), OTHER_BELTS)
def test_other_treadmills(speed_m_s: float, seed: int, num_cameras: int, rate_hz: float) -> None:
    act, belt_m_s = treadmill(speed_m_s, seed, num_cameras, rate_hz)
    few = 1.5 if num_cameras == 3 else 1.0
    assert gait_of(act).belt_m_s == pytest.approx(belt_m_s, abs=0.006 * few)
    assert np.abs(length_errors_m(act)).max() < 0.01 * few


def test_turns_do_not_count() -> None:
    act = Act((Walk((3.0, 0.0), 1.2), Walk((5.0, 2.5), 1.2)), (-2.0, 0.0), duration_s=9.0)
    strides = gait_of(act).strides
    turning = [stride for stride in strides if abs(stride.turn_deg) > 20.0]
    assert turning
    assert not any(stride.is_steady for stride in turning)
    assert sum(stride.is_steady for stride in strides) >= 6


@pytest.mark.parametrize("gesture", [g for g in Gesture if g is not Gesture.SHAKE_HANDS])
def test_there_is_no_gait_in_place(gesture: Gesture) -> None:
    gait = gait_of(Act((Stay(5.0, gesture), Turn(2.5), Stay(1.0)), duration_s=8.0, seed=4))
    assert not gait.events
    assert not gait.strides
    assert gait.figures is None


@pytest.mark.parametrize("name", slow_but(("kick",), ACROBATICS))
def test_acrobats_neither_walk_nor_jump(name: str) -> None:
    for part in ACROBATICS[name]:
        duration_s = part.keys[-1].time_s
        acrobat = perform_acrobatics(part.keys, (0.0, 0.0), 0.3, duration_s, np.random.default_rng(1))
        gait = analyse_gait(
            exact(acrobat_joints_at(acrobat, np.arange(0, duration_s, 1 / 60), BODY_FEET)), BODY_FEET, 60.0
        )
        assert gait.figures is None
        assert {movement.kind for movement in gait.movements} == ({"squat"} if name == "squat" else set())


def test_frames_without_person_are_no_steps() -> None:
    xyz_m = joints_at(performed(walk(1.2)), np.arange(0.0, 6.0, 1 / 60))
    xyz_m[:] = np.nan
    xyz_m[5] = 1.0
    assert analyse_gait(exact(xyz_m), BODY_FEET, 60.0).figures is None
    assert analyse_gait(exact(xyz_m[:0]), BODY_FEET, 60.0).figures is None
    hidden_m = joints_at(performed(walk(1.2)), np.arange(0.0, 6.0, 1 / 60))
    hidden_m[90:150] = np.nan
    gait = analyse_gait(exact(hidden_m), BODY_FEET, 60.0)
    assert 0 < len(gait.strides) < len(gait_of(walk(1.2)).strides)
    assert not [event for event in gait.events if 97 < event.row < 143]
