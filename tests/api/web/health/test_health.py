"""Liveness and readiness of the service, and jobs whose detector or format is not installed."""

import json
from collections.abc import Iterator
from dataclasses import replace

import pytest

import multicap
from pipeline.core.options.config import NETWORKS, JobChoices
from pipeline.core.options.file_formats import FILE_FORMATS
from pipeline.core.options.providers import Provider
from tests.api.conftest import Live, keypoint_form, problem_of
from worker.store.model.work import WorkerState, WorkerStatus

READY = WorkerStatus("host:1", WorkerState.READY, "A worker works", detectors=JobChoices().networks.names)
COMPILING = WorkerStatus("host:2", WorkerState.STARTING, "A worker compiles the numeric kernels", 5, 14)


@pytest.fixture
def with_broker(live: Live, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    """Service whose broker responds; its workers are removed after the test."""
    monkeypatch.setattr(live.services.queue, "ping", lambda: True)
    yield live
    for worker in live.services.store.workers.all():
        live.services.store.workers.remove([worker.id])


def test_alive(live: Live) -> None:
    answer = live.client.get("/healthz")
    assert (answer.status_code, answer.json()) == (200, {"status": "ok", "version": multicap.__version__})


def test_not_ready_says_all_that_is_missing(live: Live) -> None:
    answer = live.client.get("/readyz")
    problem = problem_of(answer, 503, "not_ready")
    assert {item["code"] for item in problem["errors"]} == {"broker_unavailable", "worker_unavailable"}
    assert "retry-after" in answer.headers


def test_ready_with_worker_that_could_start(with_broker: Live) -> None:
    with_broker.services.store.workers.report(COMPILING)
    with_broker.services.store.workers.report(READY)
    answer = with_broker.client.get("/readyz")
    assert answer.status_code == 200
    names = {"database", "broker", "artifacts", "worker", "model", "disk"}
    assert answer.json()["checks"] == dict.fromkeys(names, True)
    assert answer.json()["disk_free_bytes"] > 0


def test_ready_workers_are_counted_by_execution_provider(with_broker: Live) -> None:
    gpu = Provider("cuda", "1.31.1", "NVIDIA H200")
    fallback = Provider(note="Networks run on the CPU, not by cuda: there is no driver.")
    for number, provider in enumerate((gpu, gpu, fallback)):
        with_broker.services.store.workers.report(replace(READY, id=f"host:{number + 3}", provider=provider))
    with_broker.services.store.workers.report(COMPILING)
    assert with_broker.client.get("/readyz").json()["providers"] == [
        {"name": "cuda", "device": "NVIDIA H200", "note": "", "workers": 2},
        {"name": "cpu", "device": "", "note": fallback.note, "workers": 1},
    ]


def test_jobs_are_planned_for_workers_provider_and_say_it(with_broker: Live) -> None:
    """Also a job whose edits or retry come when another worker is there."""
    address = f"/v1/sessions/{with_broker.session_id()}/jobs"
    store = with_broker.services.store
    assert with_broker.client.post(address, json={}).json()["provider"] == "cpu"
    store.workers.report(replace(READY, provider=Provider("cuda", "1.31.1", "NVIDIA H200")))
    job = with_broker.client.post(address, json={}).json()
    assert job["provider"] == "cuda"
    assert store.jobs.get(job["id"]).provider == "cuda 1.31.1"
    with_broker.client.post(job["urls"]["cancel"]).raise_for_status()
    assert with_broker.client.post(f"/v1/jobs/{job['id']}/retry").json()["provider"] == "cuda"
    with_broker.client.post(job["urls"]["cancel"]).raise_for_status()
    store.workers.report(READY)  # the GPU is gone
    assert with_broker.client.post(f"/v1/jobs/{job['id']}/retry").json()["provider"] == "cpu"


def test_jobs_without_networks_have_no_provider(with_broker: Live) -> None:
    answer = with_broker.client.post("/v1/jobs", files=keypoint_form())
    assert answer.json()["provider"] is None


def test_worker_that_starts_says_how_far_it_is(with_broker: Live) -> None:
    with_broker.services.store.workers.report(COMPILING)
    (item,) = problem_of(with_broker.client.get("/readyz"), 503, "not_ready")["errors"]
    message = "A worker compiles the numeric kernels: 5 of 14 steps. A first start takes some minutes."
    assert (item["code"], item["message"]) == ("worker_starting", message)


def test_worker_without_usual_detector_is_not_enough(with_broker: Live) -> None:
    with_broker.services.store.workers.report(WorkerStatus("host:3", WorkerState.READY, "A worker works"))
    (item,) = problem_of(with_broker.client.get("/readyz"), 503, "not_ready")["errors"]
    assert (item["code"], item["hint"]) == (
        "model_unavailable",
        "Run: multicap models install movenet-multipose-int8 blazepose-full",
    )


@pytest.mark.parametrize("detector", ["openpose-mobilenet-thin", "human-pose-estimation-0001"])
def test_detector_that_no_worker_has_is_refused(with_broker: Live, detector: str) -> None:
    live, session_id = with_broker, with_broker.session_id()
    live.services.store.workers.report(READY)
    spec = {"detector": detector}
    refused = {"/detector": live.client.post(f"/v1/sessions/{session_id}/jobs", json=spec)}
    files = [("videos", ("cam_0.mp4", b"video")), ("calibration", ("calibration.toml", b"[cam_0]"))]
    part = ("spec", (None, f'{{"detector": "{detector}"}}', "application/json"))
    refused["/spec/detector"] = live.client.post("/v1/jobs", files=[*files, part])
    for pointer, answer in refused.items():
        (item,) = problem_of(answer, 422, "invalid_request")["errors"]
        assert (item["code"], item["pointer"]) == ("detector_not_installed", pointer)
        assert detector in item["message"]
        assert f" {detector}" in item["hint"]
    assert live.client.get("/v1/jobs").json()["jobs"] == []
    assert live.client.post(f"/v1/sessions/{session_id}/jobs", json={}).status_code == 202
    # Keypoints need no detector.
    assert live.client.post("/v1/jobs", files=[*keypoint_form(), part]).status_code == 202


def test_without_worker_nobody_knows_and_job_waits(with_broker: Live) -> None:
    live = with_broker
    address = f"/v1/sessions/{live.session_id()}/jobs"
    spec = {"detector": "openpose-mobilenet-thin"}
    live.services.store.workers.report(COMPILING)
    job = live.client.post(address, json=spec)
    assert job.status_code == 202
    assert {one["installed"] for one in live.client.get("/v1/options").json()["detectors"]} == {None}
    live.client.post(job.json()["urls"]["cancel"]).raise_for_status()
    live.services.store.workers.report(READY)
    (item,) = problem_of(live.client.post(f"{job.json()['urls']['self']}/retry"), 422, "invalid_request")["errors"]
    # The request has no field for a pointer.
    assert (item["code"], item["pointer"]) == ("detector_not_installed", None)
    listed = {one["name"]: one["installed"] for one in live.client.get("/v1/options").json()["detectors"]}
    assert listed == {name: name == "movenet-multipose-int8" for name in NETWORKS}


def test_format_that_no_worker_writes_is_refused_and_not_offered(with_broker: Live) -> None:
    live, session_id = with_broker, with_broker.session_id()
    address, spec = f"/v1/sessions/{session_id}/jobs", {"exports": ["bvh", "usd"]}

    def offered() -> set[str]:
        (exports,) = (c for c in live.client.get("/v1/options").json()["choices"] if c["name"] == "exports")
        return {value["name"] for value in exports["values"]}

    # Without a ready worker nobody knows, and the job waits.
    assert offered() == set(FILE_FORMATS)
    job = live.client.post(address, json=spec)
    live.client.post(job.json()["urls"]["cancel"]).raise_for_status()
    live.services.store.workers.report(READY)
    assert offered() == set(FILE_FORMATS) - {"usd", "osim", "rerun"}
    part = ("spec", (None, json.dumps(spec), "application/json"))
    refused = {
        "/exports": live.client.post(address, json=spec),
        "/spec/exports": live.client.post("/v1/jobs", files=[*keypoint_form(), part]),
        None: live.client.post(f"{job.json()['urls']['self']}/retry"),
    }
    for pointer, answer in refused.items():
        (item,) = problem_of(answer, 422, "invalid_request")["errors"]
        assert (item["code"], item["pointer"]) == ("format_not_installed", pointer)
        assert "multicap[usd]" in item["hint"]
    live.services.store.workers.report(replace(READY, formats=("bvh", "usd")))
    assert offered() == set(FILE_FORMATS) - {"osim", "rerun"}
    assert live.client.post(address, json=spec).status_code == 202


def test_profile_without_its_networks_is_refused_and_listed(with_broker: Live) -> None:
    live, session_id = with_broker, with_broker.session_id()
    live.services.store.workers.report(READY)
    spec = {"profile": "accurate", "joints": "whole"}
    answer = live.client.post(f"/v1/sessions/{session_id}/jobs", json=spec)
    (item,) = problem_of(answer, 422, "invalid_request")["errors"]
    assert (item["code"], item["pointer"]) == ("detector_not_installed", "/profile")
    assert item["hint"] == "Run: multicap models install movenet-multipose blazepose-heavy mediapipe-hand"
    profiles = {one["name"]: one for one in live.client.get("/v1/options").json()["profiles"]}
    installed = {
        (name, one["joints"]): one["installed"] for name, profile in profiles.items() for one in profile["joints"]
    }
    assert {key for key, is_installed in installed.items() if is_installed} == {
        (profile, joints) for profile in ("fast", "balanced") for joints in ("body", "feet")
    }
    assert profiles["fast"]["default_joints"] == "body"


def test_body_missing_on_workers_is_refused_where_files_need_it(with_broker: Live) -> None:
    live, session_id = with_broker, with_broker.session_id()
    address = f"/v1/sessions/{session_id}/jobs"
    spec = {"body": "human", "exports": ["glb"]}
    # Without a worker nobody knows, and the job waits.
    waiting = live.client.post(address, json=spec)
    assert waiting.status_code == 202
    live.client.post(waiting.json()["urls"]["cancel"]).raise_for_status()
    live.services.store.workers.report(READY)
    part = ("spec", (None, '{"body": "human", "exports": ["fbx"]}', "application/json"))
    refused = {
        "/body": live.client.post(address, json=spec),
        "/spec/body": live.client.post("/v1/jobs", files=[*keypoint_form(), part]),
        None: live.client.post(f"{waiting.json()['urls']['self']}/retry"),
    }
    for pointer, answer in refused.items():
        (item,) = problem_of(answer, 422, "invalid_request")["errors"]
        assert (item["code"], item["pointer"]) == ("body_not_installed", pointer)
        assert item["hint"] == "Run: multicap bodies install"
    for other in ({"body": "human", "exports": ["bvh"]}, {"body": "capsules", "exports": ["glb"]}):
        assert live.client.post(address, json=other).status_code == 202
    live.services.store.workers.report(replace(READY, bodies=("human",)))
    assert live.client.post(address, json=spec).status_code == 202
