"""Recordings by the stages of a job: what cameras saw stands beside what was made of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="rerun-sdk is not installed (the extra `rerun`)")

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.export.rerun.test_rerun_file import joints_of, rows
from tests.pipeline.simulations import write_simulation


def test_recording_has_what_was_seen_and_what_was_made_of_it(tmp_path: Path) -> None:
    simulation = record(replace(find_scene("room"), duration_s=2.0), seed=6)
    write_simulation(simulation, tmp_path)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    out = tmp_path / "out"
    config = ReconstructionConfig(exports=("rerun",), frame_range=(10, 40), smoothing="none")
    written = reconstruct_to_files(session, out, config)
    assert {path.name for path in written.paths} == {"take.rrd", "skeletons.json", "metrics.json"}
    document = json.loads((out / "skeletons.json").read_bytes())
    path, num_joints = out / "take.rrd", len(document["joint_names"])
    num_seen = num_free = 0
    for track in document["tracks"]:
        located = joints_of(path, f"world/people/person-{track['id']}/located", "Points3D", num_joints, 3)
        for frame, positions_m in enumerate(track["positions_m"], track["start_frame"]):
            expected_m = [position_m or [np.nan] * 3 for position_m in positions_m]
            np.testing.assert_allclose(located[frame], expected_m, atol=1e-4)
    for camera in session.cameras:
        image = f"world/cameras/{camera.name}/image"
        nobody = rows(path, f"{image}/nobody", "Points2D:positions")
        assert set(nobody) <= set(range(30))
        num_free += sum(len(points) for _, points in nobody.values())
        for track in document["tracks"]:
            given = rows(path, f"{image}/person-{track['id']}", "Points2D:positions")
            num_seen += sum(len(points) for _, points in given.values())
    # Nearly all bodies are somebody's.
    assert num_seen > 1000
    assert num_free < 0.1 * num_seen
