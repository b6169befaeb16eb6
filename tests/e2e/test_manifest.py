"""Manifest of a session: offsets give the same files as in the library, and all problems are reported."""

import json
from pathlib import Path
from typing import Any

import httpx2
import pytest

from pipeline.capture.session import Recording, open_session
from pipeline.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.runtime.packages.samples import Sample
from pipeline.stages.local import reconstruct
from tests.e2e.serving import Served, digests
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import write_video

pytestmark = pytest.mark.xdist_group("sample")

SPEC = {"smoothing": "none", "frame_range": [10, 22]}


def send(served: Served, videos: list[Path], rig: Path, manifest: Any) -> httpx2.Response:
    parts: list[tuple[str, Any]] = [("videos", (path.name, path.read_bytes())) for path in videos]
    parts += [("calibration", (rig.name, rig.read_bytes())), ("manifest", (None, json.dumps(manifest).encode()))]
    return served.client.post("/v1/jobs", files=[*parts, ("spec", (None, json.dumps(SPEC)))])


def test_offsets(served: Served, sample: Sample, tmp_path: Path) -> None:
    videos = list(sample.videos.values())
    recordings = [Recording("cam02", videos[1].name, 0.04), Recording("cam03", offset_s=-0.08)]
    session = open_session(videos, sample.calibration, recordings)
    config = ReconstructionConfig(smoothing="none", frame_range=(10, 22))
    write_results(reconstruct(session, config), tmp_path)
    said = [{"name": "cam02", "file": videos[1].name, "offset_s": 0.04}, {"name": "cam03", "offset_s": -0.08}]
    answer = send(served, videos, sample.calibration, {"cameras": said})
    assert answer.status_code == 202, answer.text
    assert served.wait_for_end(answer.json()["id"])["state"] == "succeeded"
    assert served.downloads(answer.json()["id"]) == digests(tmp_path)
    preflight = served.client.get(answer.json()["links"]["session"]).json()["preflight"]
    assert [camera["start_time_s"] for camera in preflight["cameras"]] == [0.0, 0.04, -0.08, 0.0]
    assert preflight["timebase"]["start_time_s"] == -0.08


def test_all_problems_are_reported(served: Served, tmp_path: Path) -> None:
    videos = [write_video(tmp_path / f"{name}.mp4", 10) for name in ("a", "b")]
    rig = calibration(tmp_path / "rig.json", ["a", "b"])
    cameras = [{"name": "c"}, {"name": "a", "file": "x.mp4"}]
    problem = send(served, videos, rig, {"cameras": cameras, "units": "mm"}).json()
    assert {(item["code"], item["camera"]) for item in problem["errors"]} == {("calibration_units", None)}
    problem = send(served, videos, rig, {"cameras": cameras}).json()
    assert {(item["code"], item["camera"]) for item in problem["errors"]} == {
        ("recording_camera_unknown", "c"),
        ("recording_file_unknown", "a"),
    }
    problem = send(served, videos, rig, {"cameras": [{"name": "a", "offset_s": 60.0}]}).json()
    assert {item["code"] for item in problem["errors"]} == {"no_overlap"}
