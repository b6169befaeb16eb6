"""Jumps, squats, sitting down and standing up of simulated people, against the exact truth."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.joints import BODY_FEET, COCO_17
from pipeline.motion.gait.analysis import analyse_gait
from pipeline.motion.gait.movements import BodyMovement, find_flights
from pipeline.motion.gait.points import body_points
from pipeline.validation.simulation.motion.performance import joints_at
from pipeline.validation.simulation.motion.script import Gesture
from tests.cases import slow_but
from tests.pipeline.motion.gait.walks import Act, exercise, gait_of, performed, track_of
from tests.pipeline.validation.simulation.true_events import flights_s

GRAVITY_M_S2 = 9.81
KINDS = {
    Gesture.SQUAT: ("squat", "squat"),
    Gesture.SIT: ("stand_to_sit", "sit_to_stand"),
}


def hips_m(act: Act, time_s: np.ndarray) -> np.ndarray:
    """True heights of the hips."""
    columns = act.joints.indices(("left_hip", "right_hip"))
    return np.asarray(joints_at(performed(act), time_s)[:, columns, 2].mean(1))


def jumps_with_truth(act: Act) -> list[tuple[BodyMovement, float, float, np.ndarray]]:
    """Found jumps, with the true heights by flight time and by the hips, and the times of the flight."""
    flights = flights_s(performed(act))
    jumps = [movement for movement in gait_of(act).movements if movement.kind == "jump"]
    assert len(jumps) == len(flights) > 1
    standing_m = hips_m(act, np.zeros(1))[0]
    return [
        (
            jump,
            GRAVITY_M_S2 * float(flight[1] - flight[0]) ** 2 / 8,
            float(hips_m(act, np.linspace(float(flight[0]), float(flight[1]), 200)).max() - standing_m),
            flight,
        )
        for jump, flight in zip(jumps, flights, strict=True)
    ]


@pytest.mark.parametrize(("num_cameras", "seed"), slow_but([(0, 1)], [(0, 1), (0, 5), (5, 12)]))
def test_heights_of_jumps(num_cameras: int, seed: int) -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP, seed, num_cameras)
    for jump, by_flight_m, by_hips_m, flight in jumps_with_truth(act):
        assert jump.height_by_flight_m == pytest.approx(by_flight_m, abs=0.015)
        assert jump.height_by_hips_m == pytest.approx(by_hips_m, abs=0.015)
        np.testing.assert_allclose([jump.start_row / 60, jump.end_row / 60], flight, atol=1 / 60)
        assert jump.confidence > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("num_cameras", "seed"), [(3, 31), (4, 32), (8, 33)])
def test_heights_of_jumps_of_other_bodies_and_cameras(num_cameras: int, seed: int) -> None:
    for jump, by_flight_m, by_hips_m, _ in jumps_with_truth(exercise(Gesture.COUNTERMOVEMENT_JUMP, seed, num_cameras)):
        assert jump.height_by_flight_m == pytest.approx(by_flight_m, abs=0.015)
        assert jump.height_by_hips_m == pytest.approx(by_hips_m, abs=0.015)


def test_ankles_tell_no_flight_time() -> None:
    for jump, _, by_hips_m, _ in jumps_with_truth(exercise(Gesture.COUNTERMOVEMENT_JUMP, 2, joints=COCO_17)):
        assert jump.height_by_flight_m is None
        assert jump.height_by_hips_m == pytest.approx(by_hips_m, abs=0.015)


@pytest.mark.parametrize("joints", [BODY_FEET, COCO_17])
@pytest.mark.parametrize("gesture", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_squats_and_seats_are_told_apart(gesture: Gesture, seed: int, joints: object) -> None:
    act = exercise(gesture, seed, joints=BODY_FEET if joints == BODY_FEET else COCO_17)
    movements = gait_of(act).movements
    height_m = hips_m(act, np.arange(0.0, 7.8, 0.01))
    assert {movement.kind for movement in movements} == set(KINDS[gesture])
    for movement in movements:
        assert movement.depth_m == pytest.approx(height_m[0] - height_m.min(), abs=0.01)
        assert movement.confidence == 1.0
    repetitions = np.count_nonzero(np.diff((height_m < height_m[0] - 0.2).astype(int)) > 0)
    assert len(movements) == repetitions * (1 if gesture is Gesture.SQUAT else 2)


def test_landings_and_countermovements_are_no_squats() -> None:
    kinds = {movement.kind for movement in gait_of(exercise(Gesture.COUNTERMOVEMENT_JUMP, 7)).movements}
    assert kinds == {"jump"}


def jump_of(act: Act) -> BodyMovement:
    return next(movement for movement in gait_of(act).movements if movement.kind == "jump")


def test_jump_survives_a_frame_without_a_toe() -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP)
    jump, track = jump_of(act), track_of(act)
    xyz_m = np.array(track.xyz_m)
    xyz_m[round(jump.start_row) + 6, act.joints.index("right_big_toe")] = np.nan
    found = analyse_gait(replace(track, xyz_m=xyz_m), act.joints, act.rate_hz).movements[0]
    assert found.start_row == pytest.approx(jump.start_row, abs=0.2)
    assert found.height_by_flight_m == pytest.approx(jump.height_by_flight_m, abs=0.01)


def test_jump_of_a_person_who_stands_on_a_box_alone_is_found() -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP)
    jump, track = jump_of(act), track_of(act)
    start = round(jump.start_row) - 20
    xyz_m = np.array(track.xyz_m[: round(jump.end_row) + 20])
    xyz_m[:start] = xyz_m[0] + [0.0, 0.0, 0.4]
    cut = replace(track.part(slice(0, len(xyz_m))), xyz_m=xyz_m)
    (found,) = [move for move in analyse_gait(cut, act.joints, act.rate_hz).movements if move.kind == "jump"]
    assert found.height_by_flight_m == pytest.approx(jump.height_by_flight_m, abs=0.01)
    assert found.height_by_hips_m == pytest.approx(jump.height_by_hips_m, abs=0.05)


@pytest.mark.parametrize("is_start", [True, False])
def test_flight_that_the_track_cuts_off_is_found(is_start: bool) -> None:
    act = exercise(Gesture.COUNTERMOVEMENT_JUMP)
    jump, track = jump_of(act), track_of(act)
    middle = round((jump.start_row + jump.end_row) / 2.0)
    points = body_points(track.part(slice(middle, None) if is_start else slice(0, middle)), act.joints, act.rate_hz)
    assert points is not None
    start, stop = find_flights(points)[0]
    assert (start if is_start else stop) == (0 if is_start else middle)
    assert (middle + stop if is_start else start) == pytest.approx(jump.end_row if is_start else jump.start_row, abs=3)
