"""Full disk: deleting works, jobs wait, nothing is lost, and every refusal states the reason."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from tests.e2e.captures import keypoint_capture
from tests.e2e.serving import Served, digests, serving
from tests.e2e.test_serve_keypoints import files
from tests.small_disk import fill, small_disk
from tests.waiting import wait_for

TUS = {"Tus-Resumable": "1.0.0", "Upload-Metadata": "filename Y2FtXzAubXA0"}
ENVIRONMENT = {"MULTICAP_LEASE_S": "3", "MULTICAP_HEARTBEAT_S": "0.5", "MULTICAP_REAP_INTERVAL_S": "1"}


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    with small_disk(tmp_path / "disk", 256) as disk, serving(disk / "data", 1, **ENVIRONMENT) as served:
        yield served


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    keypoint_capture(folder, duration_s=3.0)
    return folder


def refused(answer: httpx2.Response) -> None:
    assert (answer.status_code, answer.json()["code"]) == (507, "storage_full"), answer.text
    assert answer.json()["hint"]


def test_full_disk_is_emptied_through_api_and_jobs_go_on(served: Served, capture: Path, tmp_path: Path) -> None:
    content = files(capture)
    client = served.client
    ended = client.post("/v1/jobs", files=content).raise_for_status().json()
    assert served.wait_for_end(ended["id"])["state"] == "succeeded"
    upload = (
        client.post("/v1/uploads", headers=TUS | {"Upload-Length": "100000"}).raise_for_status().headers["location"]
    )
    waiting = client.post("/v1/jobs", files=content).raise_for_status().json()

    fill(served.data_dir / "filler")
    try:
        ready = client.get("/readyz")
        assert ready.status_code == 503
        said = {one["code"]: one["message"] for one in ready.json()["errors"]}
        assert said["storage_full"].startswith("The disk has 0 MiB left;")
        assert "multicap_disk_free_bytes 0.0\n" in client.get("/metrics").text
        refused(client.post("/v1/jobs", files=content))
        refused(client.post(f"/v1/sessions/{ended['session_id']}/jobs"))
        refused(client.post("/v1/uploads", headers=TUS | {"Upload-Length": "10"}))
        piece = TUS | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
        refused(client.patch(upload, headers=piece, content=bytes(1000)))
        assert client.get(f"/v1/jobs/{ended['id']}/results/skeletons.json").is_success

        # The service can be started again on the full disk.
        served.part("api").kill()
        assert httpx2.get(client.base_url.join("/healthz"), timeout=180, trust_env=False).is_success
        assert client.delete(upload, headers=TUS).status_code == 204
        assert client.delete(f"/v1/jobs/{ended['id']}").status_code == 204
        fill(served.data_dir / "filler")
        assert client.delete(f"/v1/sessions/{ended['session_id']}").status_code == 204
        assert client.get(f"/v1/sessions/{ended['session_id']}").status_code == 404
        fill(served.data_dir / "filler")
        time.sleep(5.0)  # longer than a lease: a worker that claims now finds no free space
        assert served.job(waiting["id"])["state"] in {"queued", "running", "succeeded"}
    finally:
        (served.data_dir / "filler").unlink()
    assert served.wait_for_end(waiting["id"])["state"] == "succeeded"
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig()), tmp_path / "results")
    assert served.downloads(waiting["id"]) == digests(tmp_path / "results")
    wait_for(lambda: client.get("/readyz").is_success)
    client.post("/v1/uploads", headers=TUS | {"Upload-Length": "10"}).raise_for_status()
    assert [path for path in (served.data_dir / "artifacts" / "jobs").iterdir() if path.name != waiting["id"]] == []


def test_files_are_for_their_owner_alone(tmp_path: Path, capture: Path) -> None:
    old_umask = os.umask(0o000)
    try:
        with serving(tmp_path / "data", 1, **ENVIRONMENT) as served:
            job = served.client.post("/v1/jobs", files=files(capture)).raise_for_status().json()
            served.client.post("/v1/uploads", headers=TUS | {"Upload-Length": "10"}).raise_for_status()
            assert served.wait_for_end(job["id"])["state"] == "succeeded"
            found = [tmp_path / "data", *(tmp_path / "data").rglob("*")]
            assert len(found) > 40
            assert [path for path in found if not path.is_symlink() and path.lstat().st_mode & 0o077] == []
    finally:
        os.umask(old_umask)
