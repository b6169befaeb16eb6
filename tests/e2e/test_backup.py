"""Backup of a working service: the service is killed, restored in another folder, and continues."""

import hashlib
import json
import stat
import subprocess
import sys
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
import psutil

from pipeline.capture.keypoints import open_keypoints
from pipeline.core.options.config import ReconstructionConfig
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from tests.e2e.serving import Served, digests, serving
from tests.e2e.test_serve_keypoints import capture, files
from tests.waiting import wait_for

__all__ = ["capture"]

# Workers with a low priority may make no progress on a busy machine.
ENVIRONMENT = {"MULTICAP_NICE": "0"}
TUS = {"Tus-Resumable": "1.0.0"}
# So many jobs that some are still queued when the first jobs run.
SPECS: list[dict[str, Any]] = [
    {"method": "clustering"},
    {"method": "tracking", "smoothing": "none"},
    {"method": "tracking", "smoothing": "butterworth", "cutoff_hz": 5.0},
    {"method": "clustering", "smoothing": "none"},
    {"method": "tracking", "smoothing": "one-euro"},
]


def multicap(*arguments: str | Path) -> dict[str, Any]:
    """Run a command; return the JSON object that it prints."""
    command = [sys.executable, "-m", "api.cli.main", *map(str, arguments), "--json"]
    answer = subprocess.run(command, check=False, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    return dict(json.loads(answer.stdout))


def as_the_library_does(capture: Path, folder: Path, spec: dict[str, Any]) -> dict[str, str]:
    folder.mkdir()
    session = open_keypoints(capture / "keypoints", capture / "calibration.json", capture / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig(**spec)), folder)
    return digests(folder)


def begin_upload(client: httpx2.Client, name: str, content: bytes, num_bytes: int) -> str:
    """Send the first bytes of a file; return the id of its upload."""
    headers = TUS | {
        "Upload-Length": str(len(content)),
        "Upload-Metadata": f"filename {b64encode(name.encode()).decode()}",
    }
    answer = client.post("/v1/uploads", headers=headers).raise_for_status()
    append(client, answer.headers["Location"], content[:num_bytes], 0)
    return str(answer.headers["Location"]).rpartition("/")[2]


def append(client: httpx2.Client, address: str, content: bytes, offset: int) -> None:
    headers = TUS | {"Upload-Offset": str(offset), "Content-Type": "application/offset+octet-stream"}
    client.patch(address, content=content, headers=headers).raise_for_status()


@contextmanager
def frozen_workers(served: Served) -> Iterator[None]:
    """Suspend the workers in the middle of their chunks."""
    children = served.part("worker").children()
    for child in children:
        child.suspend()
    try:
        yield
    finally:
        for child in children:
            with suppress(psutil.NoSuchProcess):
                child.resume()


def kill_all(served: Served) -> None:
    tree = served.tree()
    for process in tree:
        with suppress(psutil.NoSuchProcess):  # the child ends with its parent
            process.kill()
    psutil.wait_procs(tree, timeout=20)


def test_restored_service_goes_on_with_everything(capture: Path, tmp_path: Path) -> None:
    parts = files(capture)
    archive = tmp_path / "backup.tar"
    with serving(tmp_path / "first", 1, **ENVIRONMENT) as first:
        secret = multicap("keys", "create", "portal", "--data", first.data_dir)["key"]
        first.client.headers["Authorization"] = f"Bearer {secret}"
        done = first.client.post("/v1/jobs", files=parts).raise_for_status().json()
        assert first.wait_for_end(done["id"])["state"] == "succeeded"
        before = first.downloads(done["id"])
        session = done["urls"]["session"]
        uploads = {name: begin_upload(first.client, name, content, len(content) // 2) for _, (name, content) in parts}
        ids = [first.client.post(f"{session}/jobs", json=spec).raise_for_status().json()["id"] for spec in SPECS]
        wait_for(lambda: any(first.job(job_id)["state"] == "running" for job_id in ids))
        with frozen_workers(first):
            report = multicap("backup", "create", archive, "--data", first.data_dir)
            kill_all(first)
    assert report["file_problems"] == []
    assert report["rows"]["jobs"]["succeeded"] >= 1
    assert report["rows"]["jobs"]["running"] >= 1
    assert report["rows"]["jobs"]["queued"] >= 1
    assert report["rows"]["uploads"] == len(parts)
    assert stat.S_IMODE(archive.stat().st_mode) == 0o600
    assert multicap("backup", "verify", archive)["faults"] == []
    multicap("backup", "restore", archive, "--data", tmp_path / "second")

    with serving(tmp_path / "second", 1, **ENVIRONMENT) as second:
        assert second.client.get("/v1/jobs").status_code == 401
        second.client.headers["Authorization"] = f"Bearer {secret}"
        assert second.downloads(done["id"]) == before
        for number, (job_id, spec) in enumerate(zip(ids, SPECS, strict=True)):
            job = second.wait_for_end(job_id)
            assert (job["state"], job["attempt"]) == ("succeeded", 1), job
            assert second.downloads(job_id) == as_the_library_does(capture, tmp_path / str(number), spec)
        sent: dict[str, Any] = {"keypoints": []}
        for part, (name, content) in parts:
            address = f"/v1/uploads/{uploads[name]}"
            offset = int(second.client.head(address, headers=TUS).raise_for_status().headers["Upload-Offset"])
            assert offset == len(content) // 2
            append(second.client, address, content[offset:], offset)
            if part == "keypoints":
                sent["keypoints"].append(uploads[name])
            else:
                sent[part] = uploads[name]
        job = second.client.post("/v1/jobs", json=sent).raise_for_status().json()
        assert second.wait_for_end(job["id"])["state"] == "succeeded"
        assert second.downloads(job["id"]) == before
        listed = second.client.get(job["urls"]["session"]).raise_for_status().json()["files"]
        assert {one["sha256"] for one in listed} == {hashlib.sha256(content).hexdigest() for _, (_, content) in parts}
