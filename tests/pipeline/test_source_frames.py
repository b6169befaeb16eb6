"""Numbers of frames of the source: where a session begins, and in its results."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.keypoints import KeypointSession, open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record
from tests.pipeline.simulations import write_simulation

RATE_HZ, FIRST = 25.0, 4321


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    write_simulation(record(replace(find_scene("room"), duration_s=1.2), seed=8, num_views=3), folder)
    return folder


def opened(capture: Path) -> KeypointSession:
    return open_keypoints(capture / "keypoints", capture / "calibration.json", frame_rate_hz=RATE_HZ)


def test_reconstruct_keypoints_from_other_number_equals_zero(capture: Path, tmp_path: Path) -> None:
    config = ReconstructionConfig(frame_range=(4, 24))
    expected = reconstruct(opened(capture), config)
    for path in sorted((capture / "keypoints").rglob("*.json"), reverse=True):
        path.rename(path.with_name(f"{int(path.name[6:18]) + FIRST:06d}_keypoints.json"))
    take = reconstruct(opened(capture), config)
    assert take.warnings == expected.warnings
    assert [check.code for check in take.check.findings] == [check.code for check in expected.check.findings]
    assert len(take.tracks) == len(expected.tracks) > 1
    for track, same in zip(take.tracks, expected.tracks, strict=True):
        assert (track.start_frame, track.num_frames) == (same.start_frame, same.num_frames)
        np.testing.assert_allclose(track.xyz_m, same.xyz_m, atol=1e-4)
    write_results(take, tmp_path, frame_rate_hz=50.0)
    skeletons = json.loads((tmp_path / "skeletons.json").read_bytes())
    assert skeletons["first_source_frame"] == FIRST + 4
    assert skeletons["start_time_s"] == pytest.approx((FIRST + 4) / RATE_HZ)
    assert (skeletons["frame_rate_hz"], skeletons["num_frames"]) == (50.0, 39)
