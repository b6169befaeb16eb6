"""Session of keypoints in the service: the same files as from the library."""

import hashlib
import importlib
import io
import json
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path, PurePosixPath
from types import ModuleType
from typing import Any

import pytest

from api.web.contract.openapi import COMMITTED
from pipeline.capture.keypoints import open_keypoints
from pipeline.core.data.cameras import FrameTimes
from pipeline.core.options.config import Method, Preset, ReconstructionConfig, Smoothing
from pipeline.core.options.file_formats import Export, formats_of_people, installed_formats
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.evaluation.camera_errors import disturb_calibration
from pipeline.validation.simulation.scenes import find_scene, record, simulation_files
from tests.e2e.serving import Served, digests
from tests.pipeline.simulations import write_simulation

# Everyday tests need no service but that of the tests of the page.
OF_PAGE, OF_SERVICE = pytest.mark.xdist_group("page"), pytest.mark.xdist_group("service")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    for name, content in simulation_files(record(replace(find_scene("unsynchronised"), duration_s=3.0), seed=4)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


def archives(capture: Path) -> list[tuple[str, tuple[str, bytes]]]:
    parts = []
    for folder in sorted((capture / "keypoints").iterdir()):
        content = io.BytesIO()
        with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as entries:
            for path in folder.iterdir():
                entries.write(path, PurePosixPath(folder.name, path.name))
        parts.append(("keypoints", (f"{folder.name}.zip", content.getvalue())))
    return parts


def files(capture: Path) -> list[tuple[str, tuple[str, bytes]]]:
    one_each = [("calibration", "calibration.json"), ("timestamps", "timestamps.csv")]
    return [*archives(capture), *((part, (name, (capture / name).read_bytes())) for part, name in one_each)]


@OF_PAGE
@pytest.mark.parametrize(
    ("method", "smoothing", "exports", "preset"),
    [
        ("tracking", "none", ("bvh",), "unreal"),
        pytest.param(
            *("clustering", "butterworth", formats_of_people(installed_formats()), "default"), marks=pytest.mark.slow
        ),
    ],
)
def test_same_files_as_without_service(
    served: Served,
    capture: Path,
    tmp_path: Path,
    method: Method,
    smoothing: Smoothing,
    exports: tuple[Export, ...],
    preset: Preset,
) -> None:
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    config = ReconstructionConfig(method=method, smoothing=smoothing, cutoff_hz=5.0)
    write_results(reconstruct(session, config), tmp_path, exports, preset)
    choices = {"method": method, "smoothing": smoothing, "cutoff_hz": 5.0, "exports": exports, "preset": preset}
    spec = ("spec", (None, json.dumps(choices)))
    answer = served.client.post("/v1/jobs", files=[*files(capture), spec])
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert job["state"] == "succeeded", job
    assert ("bodies_clustered" in [warning["code"] for warning in job["warnings"]]) == (method == "clustering")
    before = ["check_session", *(["lengths", "poses"] if method == "clustering" else [])]
    assert [stage["name"] for stage in job["stages"]] == [
        *before,
        "associate",
        "identify",
        "fit",
        "hold_feet",
        "export",
    ]
    assert len(json.loads((tmp_path / "metrics.json").read_bytes())["people"]) >= 2
    assert served.downloads(job["id"]) == digests(tmp_path)


@OF_SERVICE
@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "clustering"])
def test_some_frames_and_some_people_at_another_rate(
    served: Served, capture: Path, tmp_path: Path, method: Method
) -> None:
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    config = ReconstructionConfig(method=method, frame_range=(20, 70), people=2)
    write_results(reconstruct(session, config), tmp_path, frame_rate_hz=24.0)
    spec = ("spec", (None, json.dumps({"method": method, "frame_range": [20, 70], "output_rate_hz": 24, "people": 2})))
    answer = served.client.post("/v1/jobs", files=[*files(capture), spec])
    assert answer.status_code == 202, answer.text
    assert served.wait_for_end(answer.json()["id"])["state"] == "succeeded"
    assert served.downloads(answer.json()["id"]) == digests(tmp_path)
    skeletons = json.loads((tmp_path / "skeletons.json").read_bytes())
    rate_hz = session.timebase.frame_rate_hz
    assert (skeletons["frame_rate_hz"], skeletons["num_frames"]) == (24.0, int(49 / rate_hz * 24.0) + 1)
    assert len(skeletons["tracks"]) == 2
    assert json.loads((tmp_path / "metrics.json").read_bytes())["frame_rate_hz"] == rate_hz
    assert skeletons["start_time_s"] == pytest.approx(session.timebase.time_s(20))


@OF_SERVICE
@pytest.mark.slow
def test_session_with_measured_clocks_has_same_files(served: Served, tmp_path: Path) -> None:
    """Cameras that started apart are synchronised by the manifest's choice; a job may state another."""
    simulation = record(replace(find_scene("room"), duration_s=6.0), seed=4, num_views=3)
    late = simulation.cameras[1].name
    taken = simulation.times[late].time_s
    wrong = replace(simulation, times={**simulation.times, late: FrameTimes(taken + 0.48)})
    capture, results = tmp_path / "capture", tmp_path / "results"
    write_simulation(wrong, capture)
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig(sync="auto")), results)
    manifest = ("manifest", (None, json.dumps({"sync": "auto"})))
    answer = served.client.post("/v1/jobs", files=[*files(capture), manifest])
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert job["state"] == "succeeded", job
    assert job["stages"][0]["name"] == "synchronize"
    assert served.downloads(job["id"]) == digests(results)
    offsets_s = json.loads((results / "metrics.json").read_bytes())["sync"]["offsets_s"]
    first, second, third = (offsets_s[camera.name] for camera in simulation.cameras)
    assert second - first == pytest.approx(-0.48, abs=0.01)
    assert third - first == pytest.approx(0.0, abs=0.01)
    declared = served.client.post(job["urls"]["session"] + "/jobs", json={"sync": "declared"})
    job = served.wait_for_end(declared.json()["id"])
    assert job["state"] == "succeeded", job
    assert job["spec"]["sync"] == "declared"
    (found,) = [one for one in job["warnings"] if one["code"] == "clocks_disagree"]
    assert found["camera"] == late


@OF_SERVICE
@pytest.mark.slow
def test_disturbed_calibration_is_refined_with_same_files(served: Served, tmp_path: Path) -> None:
    simulation = disturb_calibration(record(replace(find_scene("room"), duration_s=5.0), seed=2), 1.0, 0.0, seed=1)
    capture, results = tmp_path / "capture", tmp_path / "results"
    write_simulation(simulation, capture)
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig(refine_calibration="auto")), results)
    spec = ("spec", (None, json.dumps({"refine_calibration": "auto"})))
    answer = served.client.post("/v1/jobs", files=[*files(capture), spec])
    assert answer.status_code == 202, answer.text
    job = served.wait_for_end(answer.json()["id"])
    assert [stage["name"] for stage in job["stages"]] == [
        "check_session",
        "refine",
        "associate",
        "identify",
        "fit",
        "hold_feet",
        "export",
    ]
    assert "calibration_refined" in [warning["code"] for warning in job["warnings"]]
    assert served.downloads(job["id"]) == digests(results)
    assert (results / "calibration.json").exists()


@pytest.fixture
def generated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Client that `openapi-python-client` generates from the contract."""
    config = tmp_path / "config.yaml"
    config.write_text("post_hooks: []\ncontent_type_overrides: {application/zip: application/octet-stream}\n")
    package = f"multicap_client_{tmp_path.name}"
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--path", str(COMMITTED), "--meta", "none"]
    subprocess.run(
        [*command, "--output-path", str(tmp_path / package), "--config", str(config)], check=True, capture_output=True
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    return importlib.import_module(package)


@OF_SERVICE
@pytest.mark.slow
def test_generated_client_gets_from_files_to_animations(served: Served, capture: Path, generated: ModuleType) -> None:
    def part(name: str) -> Any:
        return importlib.import_module(f"{generated.__name__}.{name}")

    models, types = part("models"), part("types")
    sent: dict[str, list[Any]] = {}
    for field, (name, content) in files(capture):
        sent.setdefault(field, []).append(types.File(payload=io.BytesIO(content), file_name=name))
    with generated.Client(base_url=str(served.client.base_url), raise_on_unexpected_status=True) as client:
        job = part("api.jobs.create_session_and_job_from_files").sync(
            client=client,
            body=models.CaptureForm(
                calibration=sent["calibration"][0],
                timestamps=sent["timestamps"][0],
                keypoints=sent["keypoints"],
                manifest=models.Manifest(name="Generated"),
                spec=models.JobSpec.from_dict({"smoothing": "none", "preset": "blender"}),
            ),
        )
        assert isinstance(job, models.JobOut), job
        deadline_s = time.monotonic() + 120
        while job.state not in {"succeeded", "failed"}:
            assert time.monotonic() < deadline_s
            time.sleep(0.2)
            job = part("api.jobs.get_job").sync(job.id, client=client)
        assert job.state == "succeeded"
        listed = part("api.results.list_results").sync(job.id, client=client)
        animations = [result for result in listed.results if result.kind == "bvh"]
        assert len(animations) >= 2
        for result in animations:
            answer = part("api.results.get_result").sync_detailed(job.id, result.name, client=client)
            assert hashlib.sha256(answer.content).hexdigest() == result.sha256
            assert b"ROOT hips\n" in answer.content
        archive = part("api.results.get_all_results").sync_detailed(job.id, client=client)
        with zipfile.ZipFile(io.BytesIO(archive.content)) as packed:
            assert set(packed.namelist()) == {
                f"person-{result.person}/{result.download_name}" if result.person else result.download_name
                for result in listed.results
            }


@OF_PAGE
def test_everything_that_is_wrong_with_archives_at_once(served: Served, capture: Path) -> None:
    parts = files(capture)
    name, content = parts[0][1]
    with zipfile.ZipFile(io.BytesIO(content)) as entries:
        frames = entries.namelist()
    broken = io.BytesIO()
    with zipfile.ZipFile(broken, "w") as entries:
        entries.writestr(frames[0], '{"people": [')
    parts[0] = ("keypoints", (name, broken.getvalue()))
    problem = served.client.post("/v1/sessions", files=parts)
    assert problem.status_code == 422
    (error,) = problem.json()["errors"]
    assert error["pointer"] == "/keypoints/0"
    assert error["file"].endswith("_keypoints.json")

    parts[1] = ("keypoints", (parts[1][1][0], b"no archive"))
    parts[2] = ("keypoints", (parts[2][1][0], b"no archive either"))
    problem = served.client.post("/v1/sessions", files=parts)
    assert {error["pointer"] for error in problem.json()["errors"]} == {"/keypoints/1", "/keypoints/2"}
