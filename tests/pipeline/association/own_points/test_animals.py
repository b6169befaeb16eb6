"""Animals: files without shoulders and hips are tracked, whatever their size, and told of."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.preflight_npz import decode_keypoints, encode_record
from pipeline.core.data.rigid import Rigid3
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.export.writers.glb import GlbReader
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import Simulation, find_scene, record

NAMES = tuple(f"spot_{k}" for k in range(17))


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return record(replace(find_scene("room"), duration_s=2.0), seed=5, num_views=4)


def animals_of(simulation: Simulation, size: float) -> KeypointSession:
    """Session of the people as animals of another size, whose points have other names."""
    poses = [camera.cam_from_world for camera in simulation.cameras]
    cameras = [
        replace(camera, cam_from_world=Rigid3(pose.rotation, pose.translation_m * size))
        for camera, pose in zip(simulation.cameras, poses, strict=True)
    ]
    points_px, scores = {}, {}
    for camera in cameras:
        seen, num_frames = simulation.detections[camera.name], len(simulation.times[camera.name].time_s)
        rows = np.arange(len(seen.frame)) - np.searchsorted(seen.frame, seen.frame)
        points_px[camera.name] = np.full((num_frames, int(rows.max()) + 1, len(NAMES), 2), np.nan)
        points_px[camera.name][seen.frame, rows] = seen.keypoints_px
        scores[camera.name] = np.zeros(points_px[camera.name].shape[:3])
        scores[camera.name][seen.frame, rows] = seen.score
    times_s = {name: times.time_s for name, times in simulation.times.items()}
    return from_arrays(points_px, scores, cameras, times_s=times_s, joints=NAMES)


@pytest.mark.parametrize("size", [1.0, 0.05])
def test_animals_of_any_size_are_tracked(simulation: Simulation, size: float, tmp_path: Path) -> None:
    session = animals_of(simulation, size)
    assert not sum(len(bodies.frame) for bodies in session.detections.values())
    (told,) = [finding for finding in session.findings if finding.severity == "warning"]
    assert "followed as animals" in told.message
    assert "no skeleton fit" in told.message
    again = decode_keypoints(encode_record(session))
    for name, rows in session.own.of_animals.items():
        np.testing.assert_array_equal(again.own.of_animals[name].keypoints_px, rows.keypoints_px)
    take = reconstruct(session, ReconstructionConfig(refine_calibration="off"))
    assert not take.tracks
    assert take.warnings[-1].message == "Points of your own: animal_1, animal_2, animal_3 are animals."
    assert [thing.name for thing in take.own.objects] == ["animal_1", "animal_2", "animal_3"]
    found = set()
    for thing in take.own.objects:
        assert thing.points[0] == f"{thing.name}_spot_0"
        apart_m = np.linalg.norm(thing.track.xyz_m - size * simulation.truth_m, axis=-1)
        animal = int(np.nanmedian(apart_m, axis=(1, 2)).argmin())
        found.add(animal)
        assert np.isfinite(apart_m[animal]).mean() > 0.8
        assert np.nanmedian(apart_m[animal]) < 0.03 * size
        assert thing.track.uncertainty_m is not None
        assert 0.001 * size < np.nanmedian(thing.track.uncertainty_m) < 0.03 * size
    assert found == {0, 1, 2}
    write_results(take, tmp_path, exports=["csv", "c3d", "glb"])
    with (tmp_path / "objects.csv").open() as file:
        assert len(next(csv.reader(file))) == 2 + 3 * 3 * len(NAMES)
    with (tmp_path / "take.glb").open("rb") as file:
        names = [node["name"] for node in GlbReader(file).document["nodes"]]
    assert {"animal_1_spot_0", "animal_3_spot_16"} <= set(names)
    document = json.loads((tmp_path / "skeletons.json").read_text())
    assert [thing["name"] for thing in document["objects"]] == ["animal_1", "animal_2", "animal_3"]
