from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.people import Track3D
from pipeline.core.joints import COCO_17
from pipeline.validation.evaluation.simulated import score_simulated
from pipeline.validation.simulation.scenes import Simulation, find_scene, record


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


def test_truth_scores_full_marks(simulation: Simulation) -> None:
    scores = score_simulated(tracks_of(simulation, 2, 0, 1), simulation, COCO_17)
    assert scores["mpjpe_mm"] == 0.0
    assert scores["mota"] == scores["idf1"] == scores["people_correct"] == scores["recall"] == 1.0
    assert scores["switches"] == scores["ghost_rate"] == 0
    assert scores["hands_kept"] is None  # nobody touches
    assert scores["mpjpe_by_joint_mm"] == {
        "nose": 0.0,
        "neck": None,  # tracks of these joints have none
        **dict.fromkeys(("shoulder", "elbow", "wrist", "hip", "knee", "ankle"), 0.0),
    }


def test_missing_person_and_offset(simulation: Simulation) -> None:
    one, two = tracks_of(simulation, 0, 1)
    scores = score_simulated([one, replace(two, xyz_m=two.xyz_m + np.array([0.03, 0.0, 0.0]))], simulation, COCO_17)
    assert scores["mpjpe_mm"] == pytest.approx(15.0)
    assert scores["mota"] == pytest.approx(2 / 3)
    assert scores["people_correct"] == 0.0


def test_nobody_found(simulation: Simulation) -> None:
    scores = score_simulated([], simulation, COCO_17)
    assert (scores["mota"], scores["mpjpe_mm"], scores["bone_std_cm"]) == (0.0, None, None)


def test_touching_people_have_to_keep_both_wrists_each(simulation: Simulation) -> None:
    """The second person is moved so that their left wrist touches the first person's right wrist."""
    wrists = COCO_17.indices(("left_wrist", "right_wrist"))
    moved = simulation.truth_m.copy()
    moved[1] += (moved[0, :, wrists[1]] - moved[1, :, wrists[0]])[:, None]
    moved[2] += 20.0
    touching = replace(simulation, truth_m=moved)
    tracks = tracks_of(touching, 0, 1, 2)
    assert score_simulated(tracks, touching, COCO_17)["hands_kept"] == 1.0
    lost_m = tracks[1].xyz_m.copy()
    lost_m[:5, wrists[0]] = np.nan  # not found
    lost_m[5:10, wrists[1]] += 0.2  # too far off
    tracks[1] = replace(tracks[1], xyz_m=lost_m)
    num_frames = touching.timebase.num_frames
    assert score_simulated(tracks, touching, COCO_17)["hands_kept"] == pytest.approx((num_frames - 10) / num_frames)
    far_m = tracks[2].xyz_m.copy()
    far_m[:, wrists] = np.nan  # who touches nobody does not count
    tracks[2] = replace(tracks[2], xyz_m=far_m)
    assert score_simulated(tracks, touching, COCO_17)["hands_kept"] == pytest.approx((num_frames - 10) / num_frames)
