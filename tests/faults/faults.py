"""Faults of a service that works on a job, such as kills, clock changes and a full disk."""

import contextlib
import hashlib
import os
import random
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import psutil
import valkey
from tusclient.client import TusClient

from tests.e2e.serving import serving
from tests.faults.service import CLOCK, SmallDiskService
from tests.small_disk import fill
from tests.waiting import wait_for

# Longer than a lease.
HELD_S = 5.0
END_S = 180.0
BALLAST_BYTES = 64 * 2**20
UPLOAD_BYTES = 24 * 2**20

TUS = {"Tus-Resumable": "1.0.0", "Upload-Metadata": "filename Y2FtXzAubXA0"}


def set_clock(folder: Path, offset_s: float) -> None:
    """Offset the service's clock, except the monotonic clock."""
    new = folder / f"{CLOCK}.new"
    new.write_text(f"{offset_s:.3f}")
    new.replace(folder / CLOCK)


def kill(process: psutil.Process) -> None:
    with contextlib.suppress(psutil.NoSuchProcess):
        process.kill()


def kill_worker_child(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    kill(chance.choice(service.served.part("worker").children()))


def kill_worker(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    kill(service.served.part("worker"))


def kill_api(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    kill(service.served.part("api"))


def kill_reaper(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    kill(service.served.part("worker.run.reaper"))


def kill_broker_with_its_data(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    kill(service.served.part("valkey-server"))


def lock_database(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    with contextlib.closing(sqlite3.connect(service.data_dir / "multicap.db", timeout=30)) as database:
        database.execute("BEGIN IMMEDIATE")
        time.sleep(HELD_S)
        database.rollback()


def lose_the_message(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Kill the worker that has the message, and delete all messages of the broker."""
    kill(service.served.part("worker"))
    with valkey.Valkey(unix_socket_path=str(service.data_dir / "broker" / "socket")) as broker:
        broker.flushall()


def set_the_clock(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    set_clock(service.disk, chance.uniform(-7200.0, 7200.0))


def freeze_worker_beyond_its_lease(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Suspend a worker beyond its lease; it continues with a chunk that it has lost."""
    children = service.served.part("worker").children()
    for child in children:
        child.suspend()
    time.sleep(HELD_S)
    for child in children:
        child.resume()


def fill_the_disk(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    fill(service.filler)
    time.sleep(HELD_S)
    service.filler.unlink()


def fill_the_disk_and_empty_it_through_the_api(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Fill the disk until the job has ended; deleting an upload frees space for the job."""
    client = service.served.client
    begun = client.post("/v1/uploads", headers=TUS | {"Upload-Length": str(BALLAST_BYTES)}).raise_for_status()
    ballast = begun.headers["location"]
    piece = TUS | {"Upload-Offset": "0", "Content-Type": "application/offset+octet-stream"}
    client.patch(ballast, headers=piece, content=bytes(BALLAST_BYTES)).raise_for_status()
    fill(service.filler)
    time.sleep(chance.uniform(0.0, HELD_S))
    refused = client.post("/v1/uploads", headers=TUS | {"Upload-Length": "1"})
    assert (refused.status_code, refused.json()["code"]) == (507, "storage_full"), refused.text
    assert client.get(f"/v1/jobs/{job_id}").is_success
    assert client.delete(ballast, headers=TUS).status_code == 204


def back_up_and_restore_elsewhere(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Back up the service and restore it in another folder; it finishes the job with the same files."""
    folder = service.disk.parent / "elsewhere"
    folder.mkdir()
    command = [sys.executable, "-P", "-m", "api.cli.main", "backup"]
    environment = os.environ | service.environment()
    create = [*command, "create", str(folder / "backup"), "--data", str(service.data_dir)]
    subprocess.run(create, check=True, env=environment, capture_output=True)
    restore = [*command, "restore", str(folder / "backup"), "--data", str(folder / "data")]
    subprocess.run(restore, check=True, env=environment, capture_output=True)
    # The restored service sends no webhooks: two independent services would send each message twice.
    private = service.environment() | {"MULTICAP_WEBHOOK_PRIVATE": "false"}
    with serving(folder / "data", **private) as restored:
        wait_for(lambda: restored.job(job_id)["state"] in {"succeeded", "failed"}, timeout_s=END_S)
        service.restored = restored.downloads(job_id)
    shutil.rmtree(folder)


def kill_api_and_reaper_during_an_upload(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Kill both; the upload continues when the API has restarted, and the job's webhook still arrives."""
    content = chance.randbytes(UPLOAD_BYTES)
    path = service.disk.parent / "upload.mp4"
    path.write_bytes(content)
    sent: list[str] = []

    def send() -> None:
        endpoint = str(service.served.client.base_url.join("/v1/uploads"))
        with path.open("rb") as file:
            uploader = TusClient(endpoint).uploader(
                file_stream=file, chunk_size=2**20, metadata={"filename": "cam_0.mp4"}, retries=600, retry_delay=0.1
            )
            uploader.upload()
        sent.append(str(uploader.url))

    sending = threading.Thread(target=send)
    sending.start()
    time.sleep(chance.uniform(0.0, 1.0))
    for process in (service.served.part("worker.run.reaper"), service.served.part("api")):
        kill(process)
    sending.join(END_S)
    (url,) = sent
    stored = service.data_dir / "uploads" / url.rpartition("/")[2]
    assert hashlib.sha256(stored.read_bytes()).digest() == hashlib.sha256(content).digest()
    assert service.served.client.delete(url, headers=TUS).status_code == 204


def upgrade_the_code(service: SmallDiskService, chance: random.Random, job_id: str) -> None:
    """Upgrade the code; the new version finishes the chunks that the old version planned."""
    service.upgrade(service.disk.parent / "other_version")


Fault = Callable[[SmallDiskService, random.Random, str], None]
FAULTS: list[Fault] = [
    kill_worker_child,
    kill_worker,
    kill_api,
    kill_reaper,
    kill_broker_with_its_data,
    lock_database,
    freeze_worker_beyond_its_lease,
    fill_the_disk,
    fill_the_disk_and_empty_it_through_the_api,
    back_up_and_restore_elsewhere,
    kill_api_and_reaper_during_an_upload,
    upgrade_the_code,
    lose_the_message,
    set_the_clock,
]
# Faults that come as soon as the job is accepted; the others come at any moment.
AT_ONCE = {lose_the_message}
NEED_A_DISK = {fill_the_disk, fill_the_disk_and_empty_it_through_the_api}


def is_possible(fault: Fault, service: SmallDiskService) -> bool:
    """Return whether this machine allows the fault."""
    return fault not in NEED_A_DISK or service.disk.is_mount()


def call(service: SmallDiskService, method: str, path: str) -> httpx2.Response:
    """Repeat a request until it is answered: the API may be restarting, or the database locked."""
    deadline_s = time.monotonic() + 120
    while True:
        with contextlib.suppress(httpx2.TransportError):
            answer: httpx2.Response = service.served.client.request(method, path)
            if answer.status_code < 500:
                return answer
        assert time.monotonic() < deadline_s, f"{method} {path}"
        time.sleep(0.2)


def wait_for_end(service: SmallDiskService, job_id: str) -> dict[str, Any]:
    deadline_s = time.monotonic() + END_S
    while (job := call(service, "GET", f"/v1/jobs/{job_id}").json())["state"] not in {"succeeded", "failed"}:
        assert time.monotonic() < deadline_s, f"stuck: {job}"
        time.sleep(0.2)
    return dict(job)
