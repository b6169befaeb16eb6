"""Independent clients of tus over broken connections, to a service that is killed in the middle."""

import hashlib
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import httpx2
import obstore
import psutil
import pytest
from tusclient.client import TusClient

from api.web.settings import GIB, MIB, Settings
from tests.api.processes import peak_bytes, serving
from tests.api.web.uploads.lines import BreakingLine, breaking_line
from tests.e2e.foreign import upload_with_tus_js
from tests.ports import free_port
from tests.s3 import running_s3
from tests.waiting import wait_for
from worker.store.files.s3 import open_bucket

Send = Callable[[str, Sequence[Path], int], list[str]]


def upload_with_tuspy(endpoint: str, paths: Sequence[Path], chunk_bytes: int) -> list[str]:
    def send(path: Path) -> str:
        named = {"metadata": {"filename": path.name}, "retries": 200, "retry_delay": 0.3}
        with path.open("rb") as file:
            uploader = TusClient(endpoint).uploader(file_stream=file, chunk_size=chunk_bytes, **named)
            uploader.upload()
        return str(uploader.url)

    with ThreadPoolExecutor(len(paths)) as pool:
        return list(pool.map(send, paths))


def make_files(folder: Path, number: int, num_bytes: int) -> list[Path]:
    folder.mkdir()
    block = os.urandom(MIB)
    paths = [folder / f"cam_{index}.mp4" for index in range(number)]
    for index, path in enumerate(paths):
        with path.open("wb") as file:
            for count in range(num_bytes // MIB):
                file.write(block[index * 1000 + count % 1000 :] + block[: index * 1000 + count % 1000])
    return paths


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def kill_in_the_middle(process: psutil.Process, folder: Path, num_bytes: int) -> None:
    """Kill the service when a number of bytes has arrived."""
    deadline_s = time.monotonic() + 120
    while sum(path.stat().st_size for path in folder.iterdir()) < num_bytes:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait(20)


def session_of(client: httpx2.Client, addresses: Sequence[str], calibration: str) -> dict[str, str]:
    """Create a session from uploads; return the SHA-256 of its videos by name."""
    ids = [address.rpartition("/")[2] for address in addresses]
    body = {"videos": ids, "calibration": calibration.rpartition("/")[2]}
    answer = client.post("/v1/sessions", json=body, timeout=300)
    assert answer.status_code == 201, answer.text
    return {one["name"]: one["sha256"] for one in answer.json()["files"] if one["kind"] == "video"}


@pytest.mark.parametrize("send", [upload_with_tuspy, upload_with_tus_js])
def test_lines_break_and_service_is_killed(make_settings: Callable[..., Settings], tmp_path: Path, send: Send) -> None:
    settings, port = make_settings(), free_port()
    paths = make_files(tmp_path / "take", 3, 12 * MIB)
    (tmp_path / "calibration.toml").write_text("[cam_0]")
    # The proxy ends before the pool, so that a client that waits forever is disconnected and the test ends.
    with ThreadPoolExecutor(1) as pool, breaking_line([port], cuts=9, most_bytes=6 * MIB) as line:
        endpoint = f"http://127.0.0.1:{line.port}/v1/uploads"
        with serving(settings, port) as (_, process):
            sending = pool.submit(send, endpoint, paths, 5 * MIB)
            kill_in_the_middle(process, settings.uploads_dir, 15 * MIB)
        with serving(settings, port) as (client, _):
            addresses = sending.result(120)
            (calibration,) = send(endpoint, [tmp_path / "calibration.toml"], MIB)
            assert session_of(client, addresses, calibration) == {path.name: sha256(path) for path in paths}
            # Uploads of requests that broke off are known to no client; they expire.
            left = {path.name for path in settings.uploads_dir.iterdir()}
            assert left.isdisjoint(address.rpartition("/")[2] for address in addresses)
        assert line.cuts_made == 9


def watch(line: BreakingLine, process: psutil.Process, over: threading.Event) -> None:
    while not over.wait(5):
        print(f"{line.cuts_made} cuts, {peak_bytes(process) / MIB:.0f} MiB at most")  # noqa: T201 - a benchmark


@pytest.mark.benchmark
def test_five_gigabytes_in_eight_streams_with_fifty_cuts(
    make_settings: Callable[..., Settings], tmp_path: Path
) -> None:
    settings, port = make_settings(max_session_bytes=8 * GIB), free_port()
    paths = make_files(tmp_path / "take", 8, 640 * MIB)
    (tmp_path / "calibration.toml").write_text("[cam_0]")
    with serving(settings, port) as (client, process), breaking_line([port], 50, 60 * MIB) as line:
        endpoint, over = f"http://127.0.0.1:{line.port}/v1/uploads", threading.Event()
        watcher = threading.Thread(target=watch, args=[line, process, over])
        watcher.start()
        started_s = time.monotonic()
        addresses = upload_with_tuspy(endpoint, paths, 64 * MIB)
        print(f"{8 * 640 / (time.monotonic() - started_s):.0f} MiB a second")  # noqa: T201
        (calibration,) = upload_with_tuspy(endpoint, [tmp_path / "calibration.toml"], MIB)
        assert session_of(client, addresses, calibration) == {path.name: sha256(path) for path in paths}
        over.set()
        watcher.join()
        assert line.cuts_made == 50
        assert peak_bytes(process) < 200 * MIB
    for folder in (settings.data_dir, tmp_path / "take"):
        shutil.rmtree(folder)


@pytest.mark.parametrize(
    ("num_files", "file_bytes", "cuts"),
    [(3, 12 * MIB, 9), pytest.param(8, 640 * MIB, 50, marks=pytest.mark.benchmark)],
)
def test_one_of_two_processes_that_share_uploads_is_killed(
    make_settings: Callable[..., Settings],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    num_files: int,
    file_bytes: int,
    cuts: int,
) -> None:
    here, there = make_settings(), make_settings()
    ports = [free_port(), free_port()]
    paths = make_files(tmp_path / "take", num_files, file_bytes)
    (tmp_path / "calibration.toml").write_text("[cam_0]")
    with ExitStack() as stack:
        s3 = stack.enter_context(running_s3())
        for name, value in s3.environment.items():
            monkeypatch.setenv(name, value)
        shared = {"ARTIFACTS_URL": s3.new_url(), "DATABASE_URL": here.resolved_database_url, "SHARED_UPLOADS": "true"}
        client, process = stack.enter_context(serving(here, ports[0], None, **shared))
        _, other = stack.enter_context(serving(there, ports[1], None, **shared))
        pool = stack.enter_context(ThreadPoolExecutor(1))
        line = stack.enter_context(breaking_line(ports, cuts, file_bytes // 10))
        endpoint = f"http://127.0.0.1:{line.port}/v1/uploads"
        started_s = time.monotonic()
        sending = pool.submit(upload_with_tuspy, endpoint, paths, file_bytes // 10)
        bucket = open_bucket(shared["ARTIFACTS_URL"])
        wait_for(lambda: stored_bytes(bucket) > num_files * file_bytes / 2)
        other.send_signal(signal.SIGKILL)
        addresses = sending.result(1200)
        print(f"{num_files * file_bytes / MIB / (time.monotonic() - started_s):.0f} MiB a second")  # noqa: T201
        (calibration,) = upload_with_tuspy(endpoint, [tmp_path / "calibration.toml"], MIB)
        assert session_of(client, addresses, calibration) == {path.name: sha256(path) for path in paths}
        assert line.cuts_made == cuts
        print(f"{peak_bytes(process) / MIB:.0f} MiB at most")  # noqa: T201
        assert peak_bytes(process) < 400 * MIB
        assert stored_bytes(bucket) == 0
    for folder in (here.data_dir, there.data_dir, tmp_path / "take"):
        shutil.rmtree(folder)


def stored_bytes(bucket: obstore.store.S3Store) -> int:
    """Bytes of uploads in a bucket."""
    return sum(found["size"] for some in obstore.list(bucket, "uploads") for found in some)
