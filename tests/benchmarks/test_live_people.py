"""Benchmark `live-people` on short scenes."""

from typing import Any

import numpy as np
import pytest

from pipeline.run.live.feet import StandingFeet
from pipeline.run.live.identities import Identities
from pipeline.validation.simulation.scenes import Simulation, simulate
from tests.benchmarks import live_people
from tests.benchmarks.live_people import StandingJoints, measure_feet, measure_returns

pytestmark = pytest.mark.slow


def test_feet_that_are_not_held_slide_more(monkeypatch: pytest.MonkeyPatch) -> None:
    held = {row["joint"]: row for row in measure_feet("room", 7.0)}
    assert list(held) == ["ankle", "heel", "big_toe"]
    for row in held.values():
        assert 0.0 < row["slide_cm_s"] < 15.0
        assert 0.0 < row["fit_slide_cm_s"] < 15.0
        assert row["error_mm"] < 12.0
    monkeypatch.setattr(StandingFeet, "places_m", property(lambda feet: np.full((2, 3), np.nan)))
    for row in measure_feet("room", 7.0):
        assert row["slide_cm_s"] > 1.5 * held[row["joint"]]["slide_cm_s"]


def test_slide_is_speed_of_standing_joint() -> None:
    """People of the truth who slide to and fro by 3 cm/s."""
    simulation: Simulation = simulate("room", 1)
    ankles, rate_hz = simulation.joints.indices(("left_ankle", "right_ankle")), simulation.timebase.frame_rate_hz
    standing, slid = StandingJoints(ankles), StandingJoints(ankles)
    truth_m = simulation.truth_m[0]
    standing.add(simulation, ((frame, {1: truth_m[frame]}) for frame in range(len(truth_m))))
    exact = standing.figures()
    assert exact["slide_cm_s"] < 2.0
    assert exact["error_mm"] == 0.0
    slide_m = np.array([0.03 / rate_hz, 0.0, 0.0])
    slid.add(simulation, ((frame, {1: truth_m[frame] + frame % 2 * slide_m}) for frame in range(len(truth_m))))
    assert 1.0 < slid.figures()["slide_cm_s"] - exact["slide_cm_s"] < 3.0


@pytest.mark.parametrize("have_clothes", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_numbers_of_people_who_come_back(monkeypatch: pytest.MonkeyPatch, have_clothes: bool) -> None:
    monkeypatch.setattr(live_people, "_STAY_S", 6.0)
    figures = measure_returns(1, have_clothes=have_clothes)
    assert figures["people"] == figures["strangers"] == 3
    assert figures["back"] >= 2
    assert figures["mistaken"] + figures["strangers_mistaken"] <= 1
    assert 0.5 < figures["back_after_s"] < 4.0

    def nobody(*arguments: Any) -> None:
        """Recognise nobody."""

    monkeypatch.setattr(Identities, "see", nobody)
    assert measure_returns(1, have_clothes=have_clothes)["back"] == 0
