"""Shelf metrics of exact tracks, and of tracks with single faults."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.core.data.people import Track3D
from pipeline.geometry.camera import center_in_world
from pipeline.validation.evaluation.datasets.shelf import ShelfBenchmark, thin
from pipeline.validation.evaluation.datasets.shelf_tracking import (
    association_accuracy,
    score_single_view,
    score_tracking,
)
from pipeline.validation.evaluation.pcp import benchmark_joints
from pipeline.validation.simulation.scenes import Simulation, find_scene, record


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=2.0), seed=6)


@pytest.fixture(scope="module")
def benchmark(simulation: Simulation) -> ShelfBenchmark:
    return ShelfBenchmark(
        cameras=simulation.cameras,
        times=simulation.times,
        detections=simulation.detections,
        timebase=simulation.timebase,
        truth_m=benchmark_joints(simulation.truth_m),
    )


def track(number: int, xyz_m: np.ndarray, start_frame: int = 0) -> Track3D:
    shape = xyz_m.shape[:2]
    return Track3D(
        number, start_frame, xyz_m, np.ones(shape), np.zeros(shape, np.int64), np.ones(shape), np.full(shape, 3)
    )


@pytest.fixture
def tracks(simulation: Simulation) -> list[Track3D]:
    return [track(k, xyz_m) for k, xyz_m in enumerate(simulation.truth_m, start=1)]


def test_truth_is_right(tracks: list[Track3D], simulation: Simulation, benchmark: ShelfBenchmark) -> None:
    scores = score_tracking(tracks, benchmark)
    assert set(association_accuracy(simulation.identities, benchmark).values()) == {1.0}
    assert set(scores["mota"].values()) == set(scores["idf1"].values()) == {1.0}
    assert scores["ghost_tracks"] == 0


def test_identities_swapped_halfway_are_wrong_for_shorter_half(
    simulation: Simulation, benchmark: ShelfBenchmark
) -> None:
    swapped = {
        camera: np.where((simulation.detections[camera].frame >= 30) & (found >= 0), (found + 1) % 3, found)
        for camera, found in simulation.identities.items()
    }
    assert association_accuracy(swapped, benchmark)["all"] == pytest.approx(0.6, abs=0.05)
    nobody = {camera: np.full_like(found, -1) for camera, found in simulation.identities.items()}
    assert association_accuracy(nobody, benchmark)["all"] == 0.0


def test_duplicate_costs_and_somebody_elsewhere_does_not(
    tracks: list[Track3D], simulation: Simulation, benchmark: ShelfBenchmark
) -> None:
    elsewhere = track(9, simulation.truth_m[0] + [50.0, 0.0, 0.0])
    scores = score_tracking([*tracks, elsewhere], benchmark)
    assert min(scores["mota"].values()) == 1.0
    assert scores["ghost_tracks"] == 1
    brief = track(9, elsewhere.xyz_m[:20])
    assert score_tracking([*tracks, brief], benchmark)["ghost_tracks"] == 0
    duplicate = track(9, simulation.truth_m[0] + [0.2, 0.0, 0.0])
    scores = score_tracking([*tracks, duplicate], benchmark)
    assert max(scores["mota"].values()) < 0.9
    assert scores["ghost_tracks"] == 0


def test_person_behind_actor_with_own_track_is_not_actor(
    tracks: list[Track3D], simulation: Simulation, benchmark: ShelfBenchmark
) -> None:
    actor_m, camera = simulation.truth_m[0], simulation.cameras[0]
    middle_m = actor_m.mean(1, keepdims=True)
    away = middle_m - center_in_world(camera)
    behind = track(9, actor_m + 1.2 * away / np.linalg.norm(away, axis=-1, keepdims=True))
    wide = track(1, middle_m + [2.2, 2.2, 1.0] * (actor_m - middle_m))
    alone = replace(benchmark, truth_m=benchmark.truth_m[:1], cameras=(camera,))
    assert score_tracking([behind], alone)["missed"] == {camera.name: 0}
    assert score_tracking([wide, behind], alone)["missed"] == score_tracking([wide], alone)["missed"]
    assert score_tracking([wide], alone)["missed"][camera.name] > 0.5 * simulation.timebase.num_frames


def test_person_who_is_lost_and_switch(
    tracks: list[Track3D], simulation: Simulation, benchmark: ShelfBenchmark
) -> None:
    half = simulation.timebase.num_frames // 2
    lost = [track(1, tracks[0].xyz_m[:half]), *tracks[1:]]
    scores = score_tracking(lost, benchmark)
    assert max(scores["mota"].values()) == pytest.approx(1 - 0.5 / 3, abs=0.02)
    found_again = [*lost, track(9, tracks[0].xyz_m[half:], start_frame=half)]
    scores = score_tracking(found_again, benchmark)
    assert min(scores["mota"].values()) > 0.99
    assert max(scores["idf1"].values()) < 0.9


def test_groups_of_one_frame_are_matched_frame_by_frame(simulation: Simulation, benchmark: ShelfBenchmark) -> None:
    # Another number for everybody in every frame.
    by_frame = {
        camera: np.where(found >= 0, found + 10 * simulation.detections[camera].frame, found)
        for camera, found in simulation.identities.items()
    }
    assert association_accuracy(by_frame, benchmark, by_frame=True)["all"] == 1.0
    whole = association_accuracy(by_frame, benchmark)["all"]
    assert whole is not None
    assert whole < 0.1


def test_single_view_tracker_loses_people_that_are_hidden(benchmark: ShelfBenchmark) -> None:
    scores = score_single_view(benchmark)
    assert set(scores) == {"mota", "idf1", "switches"}
    assert all(0.3 < value <= 1.0 for value in scores["mota"].values())
    assert min(scores["idf1"].values()) < 1.0


def test_thinned_cameras_have_phases_and_truth_of_instants(benchmark: ShelfBenchmark) -> None:
    thinned, kept = thin(benchmark, 4)
    firsts = [thinned.times[camera.name].time_s[0] * 25.0 for camera in benchmark.cameras]
    assert firsts == pytest.approx([0.0, 1.0, 2.0, 3.0], abs=1.5)
    assert len(set(firsts)) == len(firsts)
    for camera in benchmark.cameras:
        ours, all_images = thinned.detections[camera.name], kept.detections[camera.name]
        np.testing.assert_allclose(
            thinned.times[camera.name].time_s[ours.frame], benchmark.times[camera.name].time_s[all_images.frame]
        )
    np.testing.assert_array_equal(thinned.truth_m, benchmark.truth_m[:, ::4])
