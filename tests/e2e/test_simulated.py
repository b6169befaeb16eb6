"""Tracking of simulated people with exact truth, seen by a simulated detector with faults."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.association.tracking.track_people import reconstruct_tracks
from pipeline.association.tracking.tracking_parameters import derive_parameters
from pipeline.capture.keypoints import KeypointSession
from pipeline.core.joints import COCO_17, COCO_18
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.local import reconstruct
from pipeline.validation.evaluation.mpjpe import BODY_JOINTS, accuracy, select_joints
from pipeline.validation.evaluation.simulated import ablate_clustering, cluster_fields, drawn_fields, score_simulated
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.simulations import write_simulation


@pytest.mark.parametrize("name", ["room", "unsynchronised"])
def test_everybody_keeps_one_identity(name: str) -> None:
    simulation = record(replace(find_scene(name), duration_s=6.0), seed=11)
    parameters = derive_parameters(simulation.cameras, simulation.timebase.frame_rate_hz)
    tracks, _ = reconstruct_tracks(
        simulation.cameras, simulation.times, simulation.detections, simulation.timebase, parameters
    )
    frames = np.arange(simulation.timebase.num_frames)
    truth_m = simulation.truth_m[:, :, COCO_17.indices(BODY_JOINTS)]
    found = accuracy(select_joints(tracks, COCO_17, BODY_JOINTS, frames), truth_m)
    assert found.switches == 0
    assert found.mpjpe_mm is not None
    assert found.mpjpe_mm <= 25
    assert found.recall is not None
    assert found.recall >= 0.97
    assert found.ghost_rate == 0


def test_hands_that_touch_stay_both_peoples() -> None:
    """Clapping, handshakes and a hug, from heatmaps and fields: people who touch keep both wrists."""
    simulation = record(replace(find_scene("contact"), duration_s=4.0), seed=2)
    with drawn_fields(simulation) as files:
        whole = score_simulated(cluster_fields(simulation, files)[0], simulation, COCO_18)
        unsplit = score_simulated(cluster_fields(simulation, files, {"split_clusters": False})[0], simulation, COCO_18)
    assert whole["hands_kept"] >= 0.9
    assert whole["hands_kept"] > unsplit["hands_kept"]
    assert whole["people_correct"] >= 0.97
    assert whole["mpjpe_mm"] <= 22
    assert whole["switches"] == 0


def test_constraints_are_worth_what_paper_says() -> None:
    """A short, small version of the paper's table 3; `multicap evaluate simulated --ablation` is the long one."""
    simulation = record(replace(find_scene("crowd"), duration_s=1.0), seed=3, num_views=8)
    with drawn_fields(simulation) as files:
        rows = ablate_clustering(simulation, files)
    errors_mm = {name: scores["mpjpe_mm"] for name, scores in rows.items()}
    assert errors_mm["All"] <= min(errors_mm["+PAF"], errors_mm["+BL"])
    assert max(errors_mm["+PAF"], errors_mm["+BL"]) < errors_mm["RE"]
    assert errors_mm["All"] <= 0.6 * errors_mm["RE"]
    assert rows["All"]["bone_std_cm"] <= 0.5 * rows["RE"]["bone_std_cm"]


def command_for(simulation: Simulation, folder: Path, *options: str) -> list[str]:
    """Write a simulation's files; return the command that reconstructs them to the folder ``out``."""
    write_simulation(simulation, folder)
    return [
        *(sys.executable, "-m", "api.cli.main", "reconstruct", "--json"),
        *("--keypoints", str(folder / "keypoints"), "--timestamps", str(folder / "timestamps.csv")),
        *("--calibration", str(folder / "calibration.json"), "--out", str(folder / "out")),
        *options,
    ]


def test_clustering_from_keypoint_files(tmp_path: Path) -> None:
    simulation = record(replace(find_scene("room"), duration_s=2.0), seed=5)
    command = command_for(simulation, tmp_path, "--method", "clustering")
    said = json.loads(subprocess.run(command, capture_output=True, check=True, timeout=120).stdout)
    assert len(said["tracks"]) == len(simulation.truth_m)
    assert "bodies_clustered" in [warning["code"] for warning in said["warnings"]]
    assert len(list((tmp_path / "out").glob("person-*.bvh"))) == len(simulation.truth_m)
    refused = subprocess.run([*command, "--tracking", "alpha_3d_m=0.2"], capture_output=True, check=False, timeout=120)
    assert refused.returncode == 2
    assert json.loads(refused.stdout)["problems"][0]["code"] == "unknown_parameter"


def test_keypoint_files_give_what_memory_gives(tmp_path: Path) -> None:
    simulation = record(replace(find_scene("room"), duration_s=2.0), seed=5)
    command = command_for(simulation, tmp_path, "--smoothing", "none")
    said = json.loads(subprocess.run(command, capture_output=True, check=True, timeout=120).stdout)
    given = simulation.cameras, simulation.times, simulation.timebase, simulation.detections, simulation.joints
    tracks = reconstruct(KeypointSession(*given, {}, ()), ReconstructionConfig(smoothing="none")).tracks
    assert len(tracks) == len(simulation.truth_m)
    assert said["tracks"] == [
        {"id": track.track_id, "start_frame": track.start_frame, "num_frames": track.num_frames} for track in tracks
    ]
    written = json.loads((tmp_path / "out" / "skeletons.json").read_bytes())["tracks"]
    for track, one in zip(tracks, written, strict=True):
        positions_m = np.array([[xyz or [np.nan] * 3 for xyz in frame] for frame in one["positions_m"]])
        np.testing.assert_allclose(positions_m, track.xyz_m, atol=1e-4)
    with np.load(tmp_path / "truth.npz") as truth:
        np.testing.assert_array_equal(truth["xyz_m"], simulation.truth_m)
