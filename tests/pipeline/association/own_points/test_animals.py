"""Animals: files without shoulders and hips are tracked, whatever their size, and told of."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.association.clustering.skeleton import clustering_skeleton
from pipeline.association.own_points.rigid import rigid_motions
from pipeline.capture.keypoint_arrays import from_arrays
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.own_points_file import with_own_points
from pipeline.capture.preflight_npz import decode_keypoints
from pipeline.core.data.rigid import Rigid3
from pipeline.core.joints import JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.export.writers.glb import GlbReader
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.records import encode_record

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
    assert not take.check.findings
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
    assert "nobody_found" not in (tmp_path / "metrics.json").read_text()
    document = json.loads((tmp_path / "skeletons.json").read_text())
    assert [thing["name"] for thing in document["objects"]] == ["animal_1", "animal_2", "animal_3"]


def test_animals_with_bones_are_clustered(simulation: Simulation, tmp_path: Path) -> None:
    """Bones are the simulated people's, from joint to joint: most have a constant length."""
    session = with_people_s_bones(animals_of(simulation, 0.05), simulation, tmp_path)
    take = reconstruct(session, ReconstructionConfig("clustering", refine_calibration="off"))
    found = set()
    for thing in take.own.objects:
        apart_m = np.linalg.norm(thing.track.xyz_m - 0.05 * simulation.truth_m, axis=-1)
        animal = int(np.nanmedian(apart_m, axis=(1, 2)).argmin())
        found.add(animal)
        assert np.isfinite(apart_m[animal]).mean() > 0.8
        assert np.nanmedian(apart_m[animal]) < 0.0015
        assert thing.bones == tuple((f"{thing.name}_{a}", f"{thing.name}_{b}") for a, b in session.own.bones)
    assert found == {0, 1, 2}
    assert len(take.own.objects) == 3
    tracked = reconstruct(session, ReconstructionConfig(refine_calibration="off"))
    # The methods take other views, so that the places differ.
    assert any(
        not np.array_equal(one.track.xyz_m, other.track.xyz_m, equal_nan=True)
        for one, other in zip(take.own.objects, tracked.own.objects, strict=True)
    )


def with_people_s_bones(session: KeypointSession, simulation: Simulation, tmp_path: Path) -> KeypointSession:
    bones = [[NAMES[simulation.joints.index(end)] for end in bone] for bone in simulation.joints.bones]
    (tmp_path / "animal.json").write_text(json.dumps({"bones": bones}))
    return with_own_points(session, tmp_path / "animal.json")


def test_animals_without_bones_are_tracked_and_told_of(simulation: Simulation) -> None:
    take = reconstruct(animals_of(simulation, 1.0), ReconstructionConfig("clustering", refine_calibration="off"))
    assert len(take.own.objects) == 3
    assert take.own.doubts == ("Animals were tracked: clustering needs bones, by a file about your own points.",)


def test_bones_make_a_tree_of_all_points() -> None:
    """The point with most bones is the root; cycles are cut; points without a bone hang on the root."""
    bones = (("a", "b"), ("b", "c"), ("c", "a"), ("b", "d"), ("f", "e"))
    skeleton = clustering_skeleton(JointSet(("a", "b", "c", "d", "e", "f", "g"), bones))
    assert not skeleton.is_persons
    assert skeleton.names[0] == "b"
    parents = {name: skeleton.names[parent] for name, parent in zip(skeleton.names, skeleton.parents, strict=True)}
    assert {name: parents[name] for name in "acdefg"} == {"a": "b", "c": "b", "d": "b", "e": "b", "f": "e", "g": "b"}
    assert {n for n, fixed in zip(skeleton.names, skeleton.is_constant, strict=True) if fixed} == {"a", "c", "d", "f"}
    assert [skeleton.sources[skeleton.names.index(name)] for name in "abcdefg"] == list(range(7))
    assert skeleton.core == skeleton.torso == list(range(7))


def test_rigid_part_of_animals_has_a_pose_each(simulation: Simulation, tmp_path: Path) -> None:
    """Five spots of the head and the trunk of a body that hardly bends."""
    names = ("nose", "left_eye", "right_eye", "left_ear")
    spots = [NAMES[simulation.joints.index(name)] for name in names]
    rows_m = simulation.truth_m[0, :, simulation.joints.indices(names)].swapaxes(0, 1)
    between_m = np.linalg.norm(rows_m[:, :, None] - rows_m[:, None], axis=-1)
    assert np.ptp(between_m, axis=0).max() < 0.005
    head = [
        [spots[i], spots[j], float(between_m[0, i, j])] for i in range(len(spots)) for j in range(i + 1, len(spots))
    ]
    (tmp_path / "head.json").write_text(json.dumps({"objects": {"head": {"distances": head}}}))
    take = reconstruct(
        with_own_points(animals_of(simulation, 1.0), tmp_path / "head.json"),
        ReconstructionConfig(refine_calibration="off"),
    )
    motions = list(rigid_motions(take.own))
    assert [motion.name for motion in motions] == ["animal_1_head", "animal_2_head", "animal_3_head"]
    assert motions[0].shape.points == tuple(f"animal_1_{spot}" for spot in spots)
    assert all(np.isfinite(motion.rms_m).mean() > 0.5 for motion in motions)
