"""People who vanish, from keypoints to ``metrics.json``, for both methods and any cut into chunks."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.data.detections import Detections
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.quality.report import all_checks, quality_report
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import Simulation, find_scene, record
from tests.pipeline.simulations import write_simulation

GONE_S, PERSON = 2.0, 1


def without_person(simulation: Simulation) -> Simulation:
    """Simulation in which no camera detects a person any more from some moment on."""

    def kept(name: str, bodies: Detections) -> Detections:
        is_gone = simulation.times[name].time_s[bodies.frame] >= GONE_S
        rows = ~(is_gone & (simulation.identities[name] == PERSON))
        parts = {part: getattr(bodies, part)[rows] for part in ("frame", "keypoints_px", "score", "box_px")}
        return replace(bodies, **parts)

    return replace(simulation, detections={name: kept(name, some) for name, some in simulation.detections.items()})


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_somebody_whom_no_camera_detects_any_more_is_finding(
    method: Literal["tracking", "clustering"], tmp_path: Path
) -> None:
    simulation = record(replace(find_scene("room"), duration_s=3.6), seed=4)
    write_simulation(without_person(simulation), tmp_path)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    config = ReconstructionConfig(method=method, smoothing="none")
    reports = [quality_report(reconstruct(session, replace(config, chunk_frames=size))) for size in (25, 7)]
    assert reports[0] == reports[1]
    (finding,) = (check for check in all_checks(reports[0]) if check.code == "person_lost")
    (person,) = finding.evidence["people"]
    frame = round(GONE_S * simulation.timebase.frame_rate_hz)
    assert person["start_frame"] == pytest.approx(frame, abs=6)
    assert person["start_frame"] + person["num_frames"] == simulation.timebase.num_frames
    true_m = simulation.truth_m[PERSON, frame].mean(0)
    assert np.linalg.norm(np.array(person["place_m"]) - true_m) < 0.25
