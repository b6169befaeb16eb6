"""Clustering from part affinity fields: a fifth of a second of the real sample capture."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.capture.session import open_session
from pipeline.core.data.reconstruction import Reconstruction
from pipeline.core.joints import COCO_18
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.packages.samples import Sample
from pipeline.detection import models
from pipeline.export.quality.report import all_checks
from pipeline.export.quality.views import reprojection_error_px
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from tests.e2e.serving import Served, digests

NUM_FRAMES = 12
CONFIG = ReconstructionConfig(
    "clustering", detector="openpose-mobilenet-thin", joint_centers="off", chunk_frames=NUM_FRAMES
)  # joints where they are marked: their distance from the marks is measured
BODY = COCO_18.indices(tuple(name for name in COCO_18.names if not name.endswith(("eye", "ear"))))


@pytest.fixture(scope="module")
def clips(sample: Sample, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first frames of every camera."""
    models.install(CONFIG.detector)
    folder = tmp_path_factory.mktemp("clips")
    for camera, video in sample.videos.items():
        with av.open(str(video)) as source, av.open(str(folder / f"{camera}.mp4"), "w") as target:
            stream = target.add_stream("libx264", rate=60, options={"crf": "18"})
            assert isinstance(stream, av.VideoStream)
            size = source.streams.video[0]
            stream.width, stream.height, stream.pix_fmt = size.width, size.height, "yuv420p"
            for number, frame in zip(range(NUM_FRAMES), source.decode(video=0), strict=False):
                frame.pts, frame.time_base = number, Fraction(1, 60)
                target.mux(stream.encode(frame))
            target.mux(stream.encode())
    return folder


@pytest.fixture(scope="module")
def clustered(clips: Path, sample: Sample) -> Reconstruction:
    return reconstruct(open_session(clips, sample.calibration), CONFIG)


def test_both_main_people_are_found_by_many_views(clustered: Reconstruction) -> None:
    seen = {one.track_id: one for one in clustered.observations}
    tracks = sorted(clustered.tracks, key=lambda track: -int(track.views.sum()))
    for track in tracks[:2]:
        errors_px = reprojection_error_px(track, seen[track.track_id], clustered.cameras)
        assert track.num_frames == NUM_FRAMES
        found = track.views[:, BODY]
        assert (found > 0).sum(1).mean() >= 9
        assert found[found > 0].mean() >= 2.8
        assert np.nanmedian(errors_px[:, :, BODY]) <= 13
    # The bystander may be found as a third person.
    assert len(tracks) <= 3
    assert [finding.code for finding in clustered.warnings] == ["calibration_note"]


def test_cut_and_processes_change_nothing(
    clips: Path, sample: Sample, clustered: Reconstruction, tmp_path: Path
) -> None:
    write_results(clustered, tmp_path / "whole")
    session = open_session(clips, sample.calibration)
    write_results(reconstruct(session, replace(CONFIG, chunk_frames=5, processes=2)), tmp_path / "cut")
    assert digests(tmp_path / "cut") == digests(tmp_path / "whole")


def test_service_gives_same_files(
    served: Served, clips: Path, sample: Sample, clustered: Reconstruction, tmp_path: Path
) -> None:
    write_results(clustered, tmp_path)
    files = [("videos", (path.name, path.read_bytes())) for path in sorted(clips.iterdir())]
    files.append(("calibration", (sample.calibration.name, sample.calibration.read_bytes())))
    spec = {"method": CONFIG.method, "detector": CONFIG.detector, "joint_centers": CONFIG.joint_centers}
    answer = served.client.post("/v1/jobs", files=[*files, ("spec", (None, json.dumps(spec)))])
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert job["state"] == "succeeded", job
    assert [stage["name"] for stage in job["stages"]] == [
        "look",
        "detect",
        "check_session",
        "lengths",
        "poses",
        "associate",
        "identify",
        "fit",
        "hold_feet",
        "export",
    ]
    assert all(stage["done"] == stage["total"] for stage in job["stages"])
    metrics = json.loads((tmp_path / "metrics.json").read_bytes())
    note, *warnings = job["warnings"]
    assert note["code"] == "calibration_note"
    assert warnings == [check.to_json() for check in all_checks(metrics)]
    assert served.downloads(job["id"]) == digests(tmp_path)


def test_same_network_groups_bodies_for_tracking(clips: Path, sample: Sample) -> None:
    session = open_session(clips, sample.calibration)
    tracks = reconstruct(session, replace(CONFIG, method="tracking")).tracks
    long = [track for track in tracks if track.num_frames >= NUM_FRAMES - 3]
    assert len(long) >= 2
