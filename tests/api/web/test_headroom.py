"""Disk without headroom: nothing new is accepted, and every refusal states the reason; tests/e2e tests deleting."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2

from api.web.settings import Settings
from tests.api.conftest import Live, form, problem_of, running
from tests.api.web.uploads.test_files import Uploader
from tests.small_disk import fill, small_disk

TUS = {"Tus-Resumable": "1.0.0", "Upload-Metadata": "filename Y2FtXzAubXA0"}
MORE_THAN_ANY_DISK = 2**62


def test_nothing_new_is_taken_in(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()
    with running(settings) as live:
        session = live.client.post("/v1/sessions", files=form()).raise_for_status().json()["id"]
        upload = live.client.post("/v1/uploads", headers=TUS | {"Upload-Length": "9"}).raise_for_status()
        address = upload.headers["location"]
    piece = TUS | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    with running(settings.model_copy(update={"headroom_bytes": MORE_THAN_ANY_DISK})) as live:
        for refused in (
            live.client.post("/v1/sessions", files=form()),
            live.client.post("/v1/jobs", files=form()),
            live.client.post("/v1/jobs", json={"videos": [], "calibration": session}),
            live.client.post(f"/v1/sessions/{session}/jobs"),
            live.client.post("/v1/uploads", headers=TUS | {"Upload-Length": "9"}),
            live.client.patch(address, headers=piece, content=b"123456789"),
        ):
            problem = problem_of(refused, 507, "storage_full")
            assert problem["hint"].startswith("Delete captures")
        assert live.client.head(address, headers=TUS).headers["upload-offset"] == "0"
        errors = live.client.get("/readyz").json()["errors"]
        assert "storage_full" in [one["code"] for one in errors]
        assert list(settings.spool_dir.iterdir()) == []
        assert live.client.delete(f"/v1/sessions/{session}").status_code == 204


def test_job_that_needs_more_space_than_is_free_is_refused(
    make_settings: Callable[..., Settings], tmp_path: Path
) -> None:
    with small_disk(tmp_path / "disk", 64) as disk:
        _refuse_jobs_on(make_settings(data_dir=disk / "data"))


def _refuse_jobs_on(settings: Settings) -> None:
    with running(settings) as live:
        session = live.client.post("/v1/sessions", files=form()).raise_for_status().json()
        foreseen = session["space"]
        assert foreseen["num_people"] == 3
        assert 0 < foreseen["scratch_bytes"] < foreseen["store_bytes"]
        job = live.client.post(f"/v1/sessions/{session['id']}/jobs", json={"exports": ["bvh", "fbx"]}).json()
        assert job["space"]["store_bytes"] > foreseen["store_bytes"]
        free_bytes = live.services.disk.free_bytes
    # Sessions and their files still fit beside the headroom, and the results of a job do not.
    headroom_bytes = free_bytes - foreseen["store_bytes"] // 2
    with running(settings.model_copy(update={"headroom_bytes": headroom_bytes})) as live:
        for refused in (
            live.client.post(f"/v1/sessions/{session['id']}/jobs"),
            live.client.post("/v1/jobs", files=form()),
        ):
            problem = problem_of(refused, 507, "space_missing")
            assert problem["detail"].startswith("The job needs about ")
            assert "frame_range" in problem["hint"]
            assert problem["retryable"]
        assert len(live.client.get("/v1/sessions").json()["sessions"]) == 1
        assert len(live.client.get("/v1/jobs").json()["jobs"]) == 1


def test_api_alone_starts_on_full_disk(make_settings: Callable[..., Settings], tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 16) as disk:
        settings = make_settings(data_dir=disk / "data")
        with running(settings) as live:
            session = live.session_id()
            job = live.client.post(f"/v1/sessions/{session}/jobs", json={}).json()
            live.finish(job["id"])
        assert (settings.data_dir / "reserve").exists()
        fill(disk / "filler")
        with running(settings) as live:
            assert live.client.get("/healthz").is_success
            assert live.client.delete(f"/v1/sessions/{session}/videos").status_code == 204
            assert live.client.get(f"/v1/jobs/{job['id']}/results/person-1.bvh").is_success
            assert live.client.delete(f"/v1/sessions/{session}").status_code == 204


def test_repeated_requests_are_answered_without_headroom(make_settings: Callable[..., Settings]) -> None:
    settings = make_settings()

    def send(live: Live, path: str, **sent: Any) -> httpx2.Response:
        return live.client.post(path, headers={"Idempotency-Key": path} | sent.pop("headers", {}), **sent)

    with running(settings) as live:
        tus = Uploader(live.client)
        video, calibration = tus.upload(b"video", "cam_0.mp4"), tus.upload(b"[cam_0]", "rig.toml")
        requests: list[tuple[str, dict[str, Any]]] = [
            ("/v1/sessions", {"json": {"videos": [video], "calibration": calibration}}),
            ("/v1/uploads", {"headers": TUS | {"Upload-Length": "9"}}),
        ]
        first = [send(live, path, **sent).raise_for_status() for path, sent in requests]
    with running(settings.model_copy(update={"headroom_bytes": MORE_THAN_ANY_DISK})) as live:
        again = [send(live, path, **sent) for path, sent in requests]
    assert [answer.headers.get("idempotent-replayed") for answer in again] == ["true", "true"]
    assert [(one.status_code, one.headers["location"]) for one in again] == [
        (one.status_code, one.headers["location"]) for one in first
    ]


def test_pages_from_elsewhere_may_read_refusal(make_settings: Callable[..., Settings]) -> None:
    portal = "https://portal.example"
    settings = make_settings(allowed_origins=frozenset({portal}), headroom_bytes=MORE_THAN_ANY_DISK)
    with running(settings) as live:
        for path, headers in (("/v1/sessions", {}), ("/v1/uploads", TUS | {"Upload-Length": "9"})):
            files = None if headers else form()
            refused = live.client.post(path, headers=headers | {"Origin": portal}, files=files)
            problem_of(refused, 507, "storage_full")
            assert refused.headers["access-control-allow-origin"] == portal
            assert refused.headers.get("tus-resumable") == headers.get("Tus-Resumable")
