"""Benchmark `service`: the sample in a service with one worker and with two workers, compared with the library."""

import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import typer

from api.cli.client import Json
from api.cli.console import JsonOption, emit, reporting
from api.cli.served import served
from pipeline.capture.session import open_session
from pipeline.core.runtime.packages import samples
from pipeline.core.runtime.packages.samples import Sample
from pipeline.detection import models
from pipeline.run.engine.local import reconstruct_to_files
from pipeline.run.engine.stage import DETECT
from pipeline.run.warm_up import warm_up
from worker.store.spec import JobSpec


def stage_seconds(job: Json) -> dict[str, float]:
    """Seconds from the start of each stage's first chunk to the end of its last chunk."""
    return {
        stage["name"]: (
            datetime.fromisoformat(stage["finished_at"]) - datetime.fromisoformat(stage["started_at"])
        ).total_seconds()
        for stage in job["stages"]
    }


def time_service(sample: Sample, workers: int, folder: Path) -> dict[str, Any]:
    """Time a session in a new service, from the first byte of the upload to the last byte of the downloads."""
    with served(folder / "service", workers) as client:
        started_s = time.perf_counter()
        job = client.submit("Sample capture", list(sample.videos.values()), sample.calibration)
        submitted_s = time.perf_counter()
        job = client.follow(job)
        followed_s = time.perf_counter()
        client.download(job, folder / "results")
        ended_s = time.perf_counter()
    return {
        "wall_s": ended_s - started_s,
        "submit_s": submitted_s - started_s,
        "job_s": followed_s - submitted_s,
        "download_s": ended_s - followed_s,
        "stages": stage_seconds(job),
    }


@contextmanager
def on_one_processor() -> Iterator[None]:
    """Bind this process, and those that it starts in the block, to one processor, where the system can."""
    if sys.platform != "linux":
        yield
        return
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(usable)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, usable)


def time_library(sample: Sample, folder: Path) -> float:
    """Time the library in one process, from the videos to the result files."""
    started_s = time.perf_counter()
    session = open_session(list(sample.videos.values()), sample.calibration)
    reconstruct_to_files(session, folder)
    return time.perf_counter() - started_s


def service(
    as_json: JsonOption = False,
) -> None:
    """Time the sample in a service with one worker and with two workers, compared with the library.

    A worker's decoders are processes of their own, so that one worker uses more than one processor. It is timed with
    a single one too.
    """
    with reporting(as_json), tempfile.TemporaryDirectory(prefix="multicap-") as folder:
        models.install_networks(JobSpec().config)
        sample = samples.install()
        warm_up()
        library_s = time_library(sample, Path(folder) / "library")
        one_worker, two_workers = (time_service(sample, workers, Path(folder) / str(workers)) for workers in (1, 2))
        with on_one_processor():
            one_processor = time_service(sample, 1, Path(folder) / "bound")
    result: Mapping[str, Any] = {
        "library_s": library_s,
        "one_worker": one_worker,
        "two_workers": two_workers,
        "one_processor": one_processor,
        "added_s": one_worker["wall_s"] - library_s,
        "speedup": one_worker["job_s"] / two_workers["job_s"],
        "processor_speedup": one_processor["job_s"] / two_workers["job_s"],
        "detect_speedup": one_worker["stages"][DETECT] / two_workers["stages"][DETECT],
    }
    if as_json:
        emit(result)
        return
    typer.echo(
        f"Library {library_s:.1f} s; "
        f"service with one worker {one_worker['wall_s']:.1f} s ({result['added_s']:+.1f} s), "
        f"with two {two_workers['wall_s']:.1f} s: {result['speedup']:.2f} times as fast, "
        f"detection {result['detect_speedup']:.2f} times; "
        f"and {result['processor_speedup']:.2f} times as fast as one worker with one processor"
    )
