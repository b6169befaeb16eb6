from dataclasses import replace

import numpy as np
import pytest

from pipeline.data import Track3D
from pipeline.metrics.simulated import score_simulated
from pipeline.simulation.scenes import Simulation, find_scene, record


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=1.0), seed=1)


def tracks_of(simulation: Simulation, *people: int) -> list[Track3D]:
    tracks = []
    for k, person in enumerate(people, start=1):
        xyz_m = simulation.truth_m[person]
        shape = xyz_m.shape[:2]
        seen = np.ones(shape)
        tracks.append(Track3D(k, 0, xyz_m, seen, np.zeros(shape, np.int64), seen, np.full(shape, 3)))
    return tracks


def test_the_truth_scores_full_marks(simulation: Simulation) -> None:
    scores = score_simulated(tracks_of(simulation, 2, 0, 1), simulation)
    assert scores["mpjpe_mm"] == 0.0
    assert scores["mota"] == scores["idf1"] == scores["people_correct"] == scores["recall"] == 1.0
    assert scores["switches"] == scores["ghost_rate"] == 0


def test_a_missing_person_and_an_offset(simulation: Simulation) -> None:
    one, two = tracks_of(simulation, 0, 1)
    scores = score_simulated([one, replace(two, xyz_m=two.xyz_m + np.array([0.03, 0.0, 0.0]))], simulation)
    assert scores["mpjpe_mm"] == pytest.approx(15.0)
    assert scores["mota"] == pytest.approx(2 / 3)
    assert scores["people_correct"] == 0.0


def test_nobody_found(simulation: Simulation) -> None:
    scores = score_simulated([], simulation)
    assert (scores["mota"], scores["mpjpe_mm"], scores["bone_std_cm"]) == (0.0, None, None)
