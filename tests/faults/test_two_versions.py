"""Two versions of the code on one database: each works on the jobs that it planned, with the same results."""

import json
import os
import sqlite3
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from subprocess import Popen

import httpx2
import psutil

from pipeline.core.options.config import Method
from tests.e2e.serving import Served, serving
from tests.e2e.test_serve_keypoints import files
from tests.faults.conftest import METHODS
from tests.faults.service import ROOT, other_version
from tests.ports import free_port
from tests.s3 import running_s3
from tests.waiting import wait_for
from worker.run.embedded import DataDirectory


@contextmanager
def running(environment: Mapping[str, str], *words: str) -> Iterator[Popen[bytes]]:
    """Run a part of the service during the block; end it with all its children."""
    with Popen([sys.executable, "-P", "-m", *words], env=environment, start_new_session=True) as process:
        try:
            yield process
        finally:
            process.terminate()


def is_ready(client: httpx2.Client) -> bool:
    try:
        return client.get("/readyz").status_code == 200
    except httpx2.TransportError:
        return False


def send(client: httpx2.Client, capture: Path, method: Method) -> str:
    spec = ("spec", (None, json.dumps({"method": method})))
    return str(client.post("/v1/jobs", files=[*files(capture), spec]).raise_for_status().json()["id"])


def workers_of(data_dir: Path, job_id: str) -> set[int]:
    """Processes that ran a job's chunks."""
    with sqlite3.connect(data_dir / "multicap.db") as database:
        rows = database.execute("SELECT worker FROM chunks WHERE job_id = ?", [job_id]).fetchall()
    return {int(worker.rpartition(":")[2]) for (worker,) in rows}


def num_ready_versions(data_dir: Path) -> int:
    """Number of versions of the code that ready workers run; jobs of other versions would be planned again."""
    with sqlite3.connect(data_dir / "multicap.db") as database:
        rows = database.execute("SELECT COUNT(DISTINCT codes) FROM workers WHERE state = 'ready'").fetchall()
    return int(rows[0][0])


def test_two_versions_work_side_by_side(
    capture: Path, undisturbed: dict[Method, dict[str, str]], tmp_path: Path
) -> None:
    port = free_port()
    with ExitStack() as opened:
        # A short path, because the length of a Unix socket's path is limited.
        data_dir = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="mc-")))
        s3 = opened.enter_context(running_s3())
        bucket = s3.environment | {"MULTICAP_ARTIFACTS_URL": s3.new_url()}
        old = opened.enter_context(serving(data_dir, PYTHONPATH=str(ROOT), **bucket))
        directory = DataDirectory(data_dir, data_dir / "broker" / "socket")
        environment = {
            **os.environ,
            **bucket,
            "PYTHONPATH": str(other_version(tmp_path / "other")),
            "MULTICAP_DATA_DIR": str(data_dir),
            "MULTICAP_BROKER_URL": directory.broker_url,
            "MULTICAP_PORT": str(port),
        }
        worker = opened.enter_context(running(environment, "worker", "--workers", "1"))
        # Each API process has a folder of its own; database, bucket and broker are the service's.
        own = {
            "MULTICAP_DATA_DIR": str(tmp_path / "api"),
            "MULTICAP_DATABASE_URL": f"sqlite:///{data_dir / 'multicap.db'}",
        }
        api = opened.enter_context(running(environment | own, "api"))
        client = opened.enter_context(httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=180, trust_env=False))
        new = Served(api, data_dir, client)  # type: ignore[arg-type]  # no text is read of it
        wait_for(lambda: is_ready(client) and num_ready_versions(data_dir) == 2, timeout_s=600)
        jobs = [(one, send(one.client, capture, method), method) for one in (old, new) for method in METHODS]
        for served, job_id, method in jobs:
            assert served.wait_for_end(job_id)["state"] == "succeeded"
            assert served.downloads(job_id) == undisturbed[method]
        of_new = {child.pid for child in psutil.Process(worker.pid).children()}
        for served, job_id, _ in jobs:
            is_by_new = [process in of_new for process in workers_of(data_dir, job_id)]
            assert is_by_new == [served is new] * len(is_by_new)
