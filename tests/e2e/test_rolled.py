"""The sample with cameras that hang turned: the same people as of the upright cameras, without an option."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from pipeline.capture.session import open_session
from pipeline.core.data.people import Track3D
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.packages.samples import Sample
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.run.session_check.instants import check_at_instants
from tests.e2e.rolled import roll

MAX_MEAN_MM = 5.0
ALL = ("cam01", "cam02", "cam03", "cam04")


def mean_distance_mm(track: Track3D, other: Track3D) -> float:
    """Mean distance of the joints of two people in the frames of both; infinity if they have none in common."""
    first, stop = (
        max(track.start_frame, other.start_frame),
        min(track.start_frame + track.num_frames, other.start_frame + other.num_frames),
    )
    if stop <= first:
        return np.inf
    ours, theirs = (some.xyz_m[first - some.start_frame : stop - some.start_frame] for some in (track, other))
    return float(np.nanmean(1000 * np.linalg.norm(ours - theirs, axis=-1)))


@pytest.mark.parametrize(
    "quarters",
    [
        pytest.param(dict.fromkeys(ALL, 1), id="on their left side", marks=pytest.mark.accuracy),
        pytest.param(dict.fromkeys(ALL, 2), id="upside down", marks=pytest.mark.accuracy),
        pytest.param({"cam02": 2}, id="one upside down"),
    ],
)
def test_people_are_those_of_upright_cameras(
    sample: Sample, reconstruction: Reconstruction, quarters: Mapping[str, int], task_cache: Path, tmp_path: Path
) -> None:
    capture = roll(sample.videos, sample.calibration, quarters, tmp_path)
    session = open_session(list(capture.videos.values()), capture.calibration)
    hanging = reconstruct(session, ReconstructionConfig(chunk_frames=100), cache=task_cache)

    # Two people and the bystander.
    assert len(hanging.tracks) == len(reconstruction.tracks) == 3
    for track in reconstruction.tracks:
        nearest = min(hanging.tracks, key=lambda other: mean_distance_mm(track, other))
        assert mean_distance_mm(track, nearest) <= MAX_MEAN_MM
        assert (nearest.start_frame, nearest.num_frames) == (track.start_frame, track.num_frames)

    write_results(hanging, tmp_path / "results")
    metrics = json.loads((tmp_path / "results" / "metrics.json").read_bytes())
    checks = metrics["session_checks"]
    turned = {check["camera"]: check["evidence"] for check in checks if check["code"] == "camera_hangs_turned"}
    assert turned == {name: {"turn_deg": (-90.0 * number) % 360} for name, number in quarters.items()}


def test_check_sees_people_of_turned_cameras(sample: Sample, tmp_path: Path) -> None:
    capture = roll(sample.videos, sample.calibration, {"cam01": 3, "cam03": 2}, tmp_path)
    session = open_session(list(capture.videos.values()), capture.calibration)
    check = check_at_instants(session, ReconstructionConfig())
    upright = check_at_instants(open_session(list(sample.videos.values()), sample.calibration), ReconstructionConfig())
    turned = {one.camera: one.evidence["turn_deg"] for one in check.findings if one.code == "camera_hangs_turned"}
    assert turned == {"cam01": 90.0, "cam03": 180.0}
    # The calibration of the sample has cam03 two degrees off.
    others = [(one.code, one.camera) for one in check.findings if one.code != "camera_hangs_turned"]
    assert others == [(one.code, one.camera) for one in upright.findings] == [("camera_disagrees", "cam03")]
    assert check.people == upright.people
