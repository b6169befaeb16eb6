"""Benchmark `cancel`: time from a cancel until no process works on the job any more."""

import contextlib
import io
import itertools
import random
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import psutil
import typer

from api.cli.client import Client, Json, ServiceError
from api.cli.console import JsonOption, emit, reporting
from api.cli.served import served
from pipeline.core.runtime.child_processes import module_command
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.samples import Sample
from pipeline.detection import models
from pipeline.validation.simulation.scenes import find_scene, record, simulation_files
from worker.store.spec import JobSpec

_WORKERS = 2
_LOOK_S = 0.1
# A process that uses less of a core counts as idle.
_IDLE_CORES = 0.2
# Number of consecutive idle samples after which the work has ended.
_IDLE_LOOKS = 5
_LONGEST_S = 60.0
_START_S = 120.0
# Jobs run longer than this, so that cancels hit all of their stages.
_LATEST_CANCEL_S = 12.0
_SCENE, _SCENE_CAMERAS, _SCENE_S = "store", 6, 20.0


def worker_processes() -> list[psutil.Process]:
    """Processes that work on chunks: children of the service's worker."""
    processes = psutil.Process().children(recursive=True)
    command = {*module_command("worker", "--workers")}
    workers = [process for process in processes if command <= {*process.cmdline()}]
    return [child for worker in workers for child in worker.children()]


def busy_until(processes: Sequence[psutil.Process], is_canceled: Callable[[], bool]) -> float:
    """Watch processes until the job is canceled and all of them are idle or have ended.

    Returns the monotonic time at which the last one was busy.
    """
    last_s = time.monotonic()
    deadline_s = last_s + _LONGEST_S
    used = {process: _cpu_s(process) for process in processes}
    quiet, canceled = 0, False
    while quiet < _IDLE_LOOKS:
        looked_s = time.monotonic()
        time.sleep(_LOOK_S)
        now_s = time.monotonic()
        if now_s > deadline_s:
            raise ServiceError(f"{_LONGEST_S:.0f} s after a cancel there is still work on the job.")
        busy = False
        for process, before_s in used.items():
            used[process] = _cpu_s(process)
            busy |= used[process] - before_s > _IDLE_CORES * (now_s - looked_s)
        if not canceled and not (canceled := is_canceled()):
            busy = True
        quiet = 0 if busy else quiet + 1
        last_s = now_s if busy else last_s
    return last_s


def _cpu_s(process: psutil.Process) -> float:
    with contextlib.suppress(psutil.NoSuchProcess):
        times = process.cpu_times()
        return float(times.user + times.system)
    return 0.0


def archives(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Zip archive of each camera's keypoint files, from the files of a simulation."""
    zips: dict[str, io.BytesIO] = {}
    for camera in sorted({Path(name).parent.name for name in files if name.startswith("keypoints/")}):
        zips[camera] = io.BytesIO()
        with zipfile.ZipFile(zips[camera], "w", zipfile.ZIP_DEFLATED) as entries:
            for name, content in files.items():
                if Path(name).parent == Path("keypoints", camera):
                    entries.writestr(f"{camera}/{Path(name).name}", content)
    return {camera: content.getvalue() for camera, content in zips.items()}


def measure(sample: Sample, folder: Path, cancels: int, seed: int) -> dict[str, Any]:
    """Measure cancels of jobs with videos and with keypoints at random moments."""
    chance = random.Random(seed)  # noqa: S311 - no secret
    files = dict(simulation_files(record(replace(find_scene(_SCENE), duration_s=_SCENE_S), seed, _SCENE_CAMERAS)))
    keypoints = (archives(files), files["calibration.json"], files["timestamps.csv"], {"method": "clustering"})
    seconds: list[float] = []
    stages: Counter[str] = Counter()
    with served(folder / "service", _WORKERS) as client:
        for turn in itertools.count():
            if turn % 2 == 0:
                job = client.submit("Videos", list(sample.videos.values()), sample.calibration)
            else:
                job = client.submit_keypoints(*keypoints)
            stage = _stage_after(client, job, chance.uniform(0.0, _LATEST_CANCEL_S))
            if stage is not None:
                stages[stage] += 1
                seconds.append(_cancel(client, job))
            else:
                client.follow(job)
            client.delete_session(job)
            if len(seconds) == cancels:
                break
    p50, p95 = (float(value) for value in np.percentile(seconds, [50, 95]))
    return {"cancels": cancels, "p50_s": p50, "p95_s": p95, "max_s": max(seconds), "stages": dict(stages)}


def _cancel(client: Client, job: Json) -> float:
    """Cancel a job; return the seconds until no process works on it."""

    def is_canceled() -> bool:
        return bool(client.get(job["urls"]["self"])["state"] == "canceled")

    processes = worker_processes()
    asked_s = time.monotonic()
    client.cancel(job)
    return busy_until(processes, is_canceled) - asked_s


def _stage_after(client: Client, job: Json, then_s: float) -> str | None:
    """Wait until a job has run for some seconds; return its present stage, or ``None`` if it has ended."""
    deadline_s = time.monotonic() + _START_S
    while job["state"] == "queued":
        if time.monotonic() > deadline_s:
            raise ServiceError("The workers do not begin.")
        time.sleep(_LOOK_S)
        job = client.get(job["urls"]["self"])
    time.sleep(then_s)
    job = client.get(job["urls"]["self"])
    if job["state"] != "running":
        return None
    return next((stage["name"] for stage in job["stages"] if stage["state"] == "running"), "between stages")


def cancel(
    cancels: Annotated[int, typer.Option(min=1, max=1000, help="Number of jobs to cancel.")] = 40,
    seed: Annotated[int, typer.Option(help="Random seed of the moments of cancels.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Time how long processes keep working on jobs that are canceled at random moments."""
    with reporting(as_json), tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        models.install_networks(JobSpec().config)
        result = measure(samples.install(), Path(folder), cancels, seed)
    if as_json:
        emit(result)
        return
    stages = ", ".join(f"{number} in {stage}" for stage, number in sorted(result["stages"].items()))
    typer.echo(
        f"{cancels} cancels ({stages}): median {result['p50_s']:.1f} s, p95 {result['p95_s']:.1f}, "
        f"longest {result['max_s']:.1f} until no process works on the job"
    )
