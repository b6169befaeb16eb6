"""First start without compiled kernels: the service reports its progress, and is ready when a job can start."""

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2

from api.cli.served import READY
from pipeline.config import JobChoices, networks_of
from pipeline.detect import models
from pipeline.runtime.packages.samples import Sample
from pipeline.runtime.parent_watch import tied_to_parent
from pipeline.warm_up import NUM_COMPILED
from tests.api.uploads.test_upload_clients import free_port
from tests.e2e.serving import COMMAND
from tests.waiting import wait_for

COMPILING = re.compile(r"A worker compiles the numeric kernels: (\d+) of (\d+) steps\. A first start takes .*")
# Time limit on a busy machine; compiling takes minutes.
LONGEST_S = 600.0


@contextmanager
def starting(folder: Path, home: Path) -> Iterator[tuple[httpx2.Client, subprocess.Popen[str]]]:
    port = free_port()
    command = tied_to_parent([*COMMAND, "--port", str(port), "--data", str(folder / "data")])
    environment = os.environ | {"MULTICAP_HOME": str(home)}
    with (folder / "stderr").open("wb") as errors, ExitStack() as stack:
        process = stack.enter_context(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment)
        )
        address = f"http://127.0.0.1:{port}"
        client = stack.enter_context(httpx2.Client(base_url=address, timeout=180, trust_env=False))
        try:
            yield client, process
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def answers(client: httpx2.Client) -> bool:
    try:
        return client.get("/healthz").is_success
    except httpx2.TransportError:
        return False


def post_session(client: httpx2.Client, sample: Sample) -> str:
    with ExitStack() as opened:
        parts = [("videos", path) for path in sample.videos.values()] + [("calibration", sample.calibration)]
        files = [(part, (path.name, opened.enter_context(path.open("rb")))) for part, path in parts]
        return str(client.post("/v1/sessions", files=files).raise_for_status().json()["links"]["jobs"])


def wait_until_ready(client: httpx2.Client) -> list[str]:
    """Wait until the service is ready; return the sentences of ``/readyz`` meanwhile, each once."""
    said: list[str] = []
    deadline_s = time.monotonic() + LONGEST_S
    while (answer := client.get("/readyz")).status_code == 503:
        assert time.monotonic() < deadline_s, said
        said += [item["message"] for item in answer.json()["errors"] if item["message"] not in said]
        time.sleep(0.1)
    assert answer.status_code == 200, answer.text
    return said


def seconds(stage: dict[str, Any]) -> float:
    return (datetime.fromisoformat(stage["finished_at"]) - datetime.fromisoformat(stage["started_at"])).total_seconds()


def test_ready_is_said_when_a_job_would_start_at_once(sample: Sample, tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "models").mkdir(parents=True)
    for name in networks_of(JobChoices()).names:
        network = models.path_of(name)
        (home / "models" / network.name).symlink_to(network)
    with starting(tmp_path, home) as (client, process):
        wait_for(lambda: answers(client))
        jobs = post_session(client, sample)
        said = wait_until_ready(client)
        answer = client.post(jobs, json={"frame_range": [0, 4]}).raise_for_status().json()
        wait_for(lambda: client.get(answer["links"]["self"]).json()["state"] == "succeeded")
        job = client.get(answer["links"]["self"]).json()
        assert process.stdout is not None
        assert process.stdout.readline().startswith(READY)
    steps = [(int(found[1]), int(found[2])) for sentence in said if (found := COMPILING.fullmatch(sentence))]
    assert len(steps) >= 5, said
    assert steps == sorted(steps)
    assert {total for _, total in steps} == {NUM_COMPILED}
    waited_s = datetime.fromisoformat(job["stages"][0]["started_at"]) - datetime.fromisoformat(job["created_at"])
    assert waited_s.total_seconds() < 2.0
    # Without compiled kernels these would take minutes.
    assert sum(seconds(stage) for stage in job["stages"] if stage["name"] in {"associate", "fit"}) < 10.0
    told = (tmp_path / "stderr").read_text()
    assert COMPILING.search(told), told
    log = [
        json.loads(line)
        for line in (tmp_path / "data" / "logs" / "worker.log").read_text().splitlines()
        if line[:1] == "{"
    ]
    (compiled,) = [event for event in log if event["event"] == "kernels_compiled"]
    assert compiled["done"] == compiled["total"] == NUM_COMPILED
