"""Tracking of simulated people, whose truth is exact, from what a faulty detector sees of them."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.joints import COCO_17
from pipeline.metrics.mpjpe import BODY_JOINTS, accuracy, select_joints
from pipeline.simulation.scenes import find_scene, record
from pipeline.tracking.associate import reconstruct_tracks
from pipeline.tracking.parameters import derive_parameters


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
