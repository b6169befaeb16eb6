"""Accuracy of heels, toes and foot directions: exact for the truth, and as large as a known error."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.people import Source, Track3D
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.extremities.feet import heading_error_deg, pitch_deg, score_heels_and_toes
from pipeline.validation.simulation.scenes import SCENES, Simulation, record

SIMULATION = record(replace(SCENES["walk"], duration_s=3.0), 1, 2, "feet")


def tracks_of(simulation: Simulation, move_m: np.ndarray) -> list[Track3D]:
    """Tracks of the truth in reversed order, with moved joints."""
    tracks = []
    for number, xyz_m in enumerate(simulation.truth_m[::-1]):
        shape = xyz_m.shape[:2]
        tracks.append(
            Track3D(
                number + 1,
                0,
                xyz_m + move_m,
                np.ones(shape),
                np.full(shape, Source.MEASURED),
                np.zeros(shape),
                np.full(shape, 2),
            )
        )
    return tracks


def test_the_truth_has_no_error() -> None:
    scores = score_heels_and_toes(tracks_of(SIMULATION, np.zeros((21, 3))), SIMULATION, SIMULATION.joints)
    slides_cm = [scores.pop(name) for name in ("heel_slide_cm", "toe_slide_cm")]
    assert all(one is not None and 0.0 <= one < 0.2 for one in slides_cm)
    assert scores == pytest.approx(
        {"heel_mm": 0.0, "toe_mm": 0.0, "foot_pitch_deg": 0.0, "foot_heading_deg": 0.0}, abs=1e-6
    )


def test_a_lifted_heel_is_an_error_of_the_heel_and_of_the_pitch() -> None:
    move_m = np.zeros((21, 3))
    move_m[SIMULATION.joints.indices(("left_heel", "right_heel"))] = [0.0, 0.0, 0.02]
    scores = score_heels_and_toes(tracks_of(SIMULATION, move_m), SIMULATION, SIMULATION.joints)
    assert scores["heel_mm"] == pytest.approx(20.0)
    assert scores["toe_mm"] == pytest.approx(0.0, abs=1e-6)
    # 2 cm over a foot of some 23 cm.
    assert scores["foot_pitch_deg"] == pytest.approx(np.degrees(0.02 / 0.23), abs=1.0)
    assert scores["foot_heading_deg"] == pytest.approx(0.0, abs=1e-6)


def test_a_heel_that_trembles_slides() -> None:
    move_m = np.zeros((SIMULATION.truth_m.shape[1], 21, 3))
    # To and fro, so that the median position is the true one.
    move_m[:, SIMULATION.joints.indices(("left_heel", "right_heel")), 0] = np.resize(
        [0.01, 0.0, -0.01, 0.0], (len(move_m), 1)
    )
    scores = score_heels_and_toes(tracks_of(SIMULATION, move_m), SIMULATION, SIMULATION.joints)
    assert scores["heel_slide_cm"] == pytest.approx(0.5, abs=0.15)
    assert scores["toe_slide_cm"] is not None
    assert scores["toe_slide_cm"] < 0.2


def test_tracks_without_feet_have_no_figures() -> None:
    body = record(replace(SCENES["walk"], duration_s=3.0), 1, 2)
    scores = score_heels_and_toes(tracks_of(body, np.zeros((17, 3))), SIMULATION, COCO_17)
    assert set(scores.values()) == {None}
    assert set(score_heels_and_toes([], SIMULATION, SIMULATION.joints).values()) == {None}


def test_angles_have_their_signs() -> None:
    assert pitch_deg(np.array([[1.0, 0.0, -1.0]])) == pytest.approx(45.0)
    ahead, left = np.array([[1.0, 0.0, 0.3]]), np.array([[0.0, 2.0, 0.0]])
    assert heading_error_deg(left, ahead) == pytest.approx(90.0)
    assert heading_error_deg(ahead, left) == pytest.approx(-90.0)
