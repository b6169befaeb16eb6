"""`multicap serve` as a process, with helpers for tests."""

import hashlib
import json
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import httpx2
import psutil

from api.cli.served import READY
from pipeline.core.runtime.packages.samples import Sample
from pipeline.core.runtime.parent_watch import tied_to_parent
from tests.waiting import wait_for

SERVE = [sys.executable, "-P", "-m", "api.cli.main", "serve"]
COMMAND = [*SERVE, "--workers", "2"]
# Processes of a service: supervisor, broker, worker with its two children, reaper and API.
NUM_PROCESSES = 7


@dataclass
class Served:
    """Running service."""

    process: Popen[str]
    data_dir: Path
    client: httpx2.Client

    def tree(self) -> list[psutil.Process]:
        supervisor = psutil.Process(self.process.pid)
        return [supervisor, *supervisor.children(recursive=True)]

    def part(self, word: str) -> psutil.Process:
        """Child of the supervisor with a name, or with a word in its command line."""
        children = psutil.Process(self.process.pid).children()
        (found,) = [one for one in children if word in [one.name(), *one.cmdline()]]
        return found

    def post(self, sample: Sample, **choices: Any) -> str:
        """Send the sample and reconstruct it with some choices; return the job's id."""
        with ExitStack() as opened:
            files = [("videos", (path.name, opened.enter_context(path.open("rb")))) for path in sample.videos.values()]
            calibration = (
                "calibration",
                (sample.calibration.name, opened.enter_context(sample.calibration.open("rb"))),
            )
            spec = ("spec", (None, json.dumps(choices), "application/json"))
            response = self.client.post("/v1/jobs", files=[*files, calibration, spec])
        assert response.status_code == 202, response.text
        return str(response.json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        return dict(self.client.get(f"/v1/jobs/{job_id}").raise_for_status().json())

    def edits(self, job_id: str) -> dict[str, Any]:
        """Edits of a job's session, in the run of the job."""
        return dict(self.client.get(self.job(job_id)["urls"]["edits"]).raise_for_status().json())

    def edit(self, job_id: str, *edits: dict[str, Any]) -> dict[str, Any]:
        """Replace the edits of a job's session, and make the job's files again."""
        path = f"{self.job(job_id)['urls']['session']}/edits"
        answer = self.client.put(path, json={"edits": edits, "job_id": job_id})
        return dict(answer.raise_for_status().json())

    def downloads(self, job_id: str) -> dict[str, str]:
        """SHA-256 of each result file as downloaded."""
        listed = self.client.get(f"/v1/jobs/{job_id}/results").raise_for_status().json()["results"]
        contents = {
            one["name"]: self.client.get(f"/v1/jobs/{job_id}/results/{one['name']}").raise_for_status().content
            for one in listed
        }
        found = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
        assert found == {one["name"]: one["sha256"] for one in listed}
        return found

    def wait_for_end(self, job_id: str) -> dict[str, Any]:
        wait_for(lambda: is_at_rest(self.job(job_id)), timeout_s=600)
        return self.job(job_id)


def is_at_rest(job: Mapping[str, Any]) -> bool:
    """Return whether a job has ended, and its files are not being made again."""
    return job["state"] in {"succeeded", "failed", "canceled"} and job["files_state"] != "updating"


# Machines of tests are busy: the check of the files may take long.
_PATIENT = {"MULTICAP_NICE": "0", "MULTICAP_PREFLIGHT_TIMEOUT_S": "240"}


@contextmanager
def serving(data_dir: Path, num_workers: int = 2, /, **environment: str) -> Iterator[Served]:
    """Run a service on a folder during the block; each worker loads the pipeline, for seconds of processor time."""
    options = ["--workers", str(num_workers), "--port", "0", "--data", str(data_dir)]
    command = tied_to_parent([*SERVE, *options])
    with Popen(command, stdout=PIPE, text=True, env=os.environ | _PATIENT | environment) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(READY)
            with httpx2.Client(base_url=line.removeprefix(READY).strip(), timeout=180, trust_env=False) as client:
                yield Served(process, data_dir, client)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(180)


class _QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def file_server(folder: Path) -> Iterator[str]:
    """Serve the files of a folder at an address, without a log, during the block."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_QuietHandler, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}
