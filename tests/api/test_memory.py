import contextlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx2
import psutil
import pytest

from api.settings import GIB, MIB, Settings
from tests.api.conftest import NO_BROKER, running

BOUNDARY = "xyz"


@contextlib.contextmanager
def serving(settings: Settings) -> Iterator[tuple[httpx2.Client, psutil.Process]]:
    """The service in a process of its own, as it is run."""
    environment = os.environ | {
        "MULTICAP_HOME": str(settings.home),
        "MULTICAP_DATA_DIR": str(settings.data_dir),
        "MULTICAP_BROKER_URL": NO_BROKER,
        "MULTICAP_PREFLIGHT_COMMAND": str(list(settings.preflight_command)).replace("'", '"'),
        "MULTICAP_PORT": "0",
        "MULTICAP_MAX_FILE_BYTES": str(3 * GIB),
    }
    log = settings.data_dir.parent / "log"
    with log.open("wb") as output:
        child = subprocess.Popen([sys.executable, "-m", "api"], env=environment, stdout=output, stderr=output)
    try:
        process = psutil.Process(child.pid)
        deadline_s = time.monotonic() + 30
        while not (listening := [c for c in process.net_connections("tcp") if c.status == psutil.CONN_LISTEN]):
            assert child.poll() is None, log.read_text()
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        address = f"http://127.0.0.1:{listening[0].laddr.port}"
        with httpx2.Client(base_url=address, timeout=300, trust_env=False) as client:
            yield client, process
    finally:
        child.terminate()
        child.wait(20)


def peak_bytes(process: psutil.Process) -> int:
    """Most resident memory that the process has had so far."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    (kib,) = re.findall(r"VmHWM:\s+(\d+) kB", status)
    return int(kib) * 1024


def session(num_bytes: int) -> Iterator[bytes]:
    head = '--xyz\r\nContent-Disposition: form-data; name="{}"; filename="{}"\r\n\r\n'
    yield head.format("calibration", "c.toml").encode() + b"[cam_0]\r\n"
    yield head.format("videos", "cam_0.mp4").encode()
    block = os.urandom(MIB)
    for _ in range(num_bytes // MIB):
        yield block
    yield b"\r\n--xyz--\r\n"


def growth_bytes(settings: Settings, num_bytes: int) -> int:
    headers = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
    with serving(settings) as (client, process):
        assert client.post("/v1/sessions", content=session(MIB), headers=headers).status_code == 201
        before = peak_bytes(process)
        answer = client.post("/v1/sessions", content=session(num_bytes), headers=headers)
        assert answer.status_code == 201, answer.text
        assert answer.json()["files"][0]["num_bytes"] == num_bytes
        return peak_bytes(process) - before


def archive_growth_bytes(settings: Settings, num_bytes: int) -> int:
    """What a large archive of results adds to the service's memory after a small one."""
    with running(settings) as live:
        small = live.job_id()
        live.finish(small)
        large = live.job_id()
        live.finish(large, os.urandom(num_bytes))
    with serving(settings) as (client, process):
        assert client.get(f"/v1/jobs/{small}/results.zip").status_code == 200
        before = peak_bytes(process)
        with client.stream("GET", f"/v1/jobs/{large}/results.zip") as answer:
            assert answer.status_code == 200
            assert sum(len(block) for block in answer.iter_bytes()) > num_bytes
        return peak_bytes(process) - before


def test_archive_takes_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert archive_growth_bytes(make_settings(), 192 * MIB) <= 12 * MIB


def test_upload_takes_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert growth_bytes(make_settings(), 192 * MIB) <= 12 * MIB


@pytest.mark.benchmark
def test_two_gigabytes_take_no_memory(make_settings: Callable[..., Settings]) -> None:
    assert growth_bytes(make_settings(), 2 * GIB) <= 64 * MIB
