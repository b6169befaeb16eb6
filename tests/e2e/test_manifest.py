"""Manifest of a session: offsets give the same files as in the library, and all problems are reported."""

import json
from itertools import islice
from pathlib import Path
from typing import Any

import av
import httpx2
import pytest

from api.cli.client import Client
from pipeline.capture.preflight_record import Recording
from pipeline.capture.session import open_session
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.packages.samples import Sample
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct, reconstruct_to_files
from tests.e2e.serving import Served, digests
from tests.pipeline.capture.test_session import calibration
from tests.pipeline.media import cut_at_keyframes, write_pictures, write_video

pytestmark = pytest.mark.xdist_group("service")

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
    preflight = served.client.get(answer.json()["urls"]["session"]).json()["preflight"]
    assert [camera["start_time_s"] for camera in preflight["cameras"]] == [0.0, 0.04, -0.08, 0.0]
    assert preflight["timebase"]["start_time_s"] == -0.08


def test_recording_in_parts_gives_same_files_as_whole(served: Served, sample: Sample, tmp_path: Path) -> None:
    """The service gets chapters, and the library the whole video: each range of frames lies across two seams."""
    whole, results = tmp_path / "cam02.mp4", tmp_path / "results"
    groups = {"g": "8", "keyint_min": "8", "sc_threshold": "0", "preset": "ultrafast"}
    with av.open(str(sample.videos["cam02"])) as container:
        pictures = [frame.to_ndarray(format="rgb24") for frame in islice(container.decode(video=0), 32)]
    write_pictures(whole, pictures, groups | {"bf": "2"})
    others = [path for name, path in sample.videos.items() if name != "cam02"]
    recordings = [Recording("cam02", frame_rate_hz=60.0)]
    session = open_session([whole, *others], sample.calibration, recordings)
    write_results(reconstruct(session, ReconstructionConfig(smoothing="none", frame_range=(10, 22))), results)
    assert json.loads((results / "metrics.json").read_bytes())["people"]
    parts = cut_at_keyframes(whole, [tmp_path / f"cam02_GX0{number}0042.MP4" for number in (1, 2, 3)])
    answer = send(
        served,
        [parts[2], *others, parts[0], parts[1]],
        sample.calibration,
        {"cameras": [{"name": "cam02", "rate": 60.0}]},
    )
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert job["state"] == "succeeded"
    preflight = served.client.get(answer.json()["urls"]["session"]).json()["preflight"]
    (camera,) = [camera for camera in preflight["cameras"] if camera["name"] == "cam02"]
    assert [camera["file"], *camera["more_files"]] == [path.name for path in parts]
    assert [finding["camera"] for finding in preflight["findings"] if finding["code"] == "parts_joined"] == ["cam02"]
    assert served.downloads(answer.json()["id"]) == digests(results)
    local = tmp_path / "local"
    session = open_session([*others, *parts], sample.calibration, recordings)
    written = reconstruct_to_files(session, local, ReconstructionConfig(smoothing="none", frame_range=(10, 22)))
    assert {path.name: path.read_bytes() for path in written.paths} == {
        path.name: path.read_bytes() for path in results.iterdir()
    }


def test_client_of_python_states_manifest(served: Served, tmp_path: Path) -> None:
    videos = [write_video(tmp_path / f"{name}.mp4", 10) for name in ("view 10", "view 9")]
    rig = calibration(tmp_path / "rig.json", ["a", "b"])
    manifest = {"pair_by_order": True, "cameras": [{"name": "b", "rate": 50.0}]}
    with Client.connect(str(served.client.base_url)) as client:
        job = client.submit("Stated", videos, rig, SPEC | {"frame_range": None}, manifest)
    session = served.client.get(job["urls"]["session"]).json()
    assert session["name"] == "Stated"
    cameras = {camera["name"]: (camera["file"], camera["frame_rate_hz"]) for camera in session["preflight"]["cameras"]}
    assert cameras == {"a": ("view 9.mp4", 25.0), "b": ("view 10.mp4", 50.0)}


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
