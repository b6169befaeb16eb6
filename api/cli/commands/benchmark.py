"""`multicap benchmark`: speed and memory, as ratios within one run."""

import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from itertools import repeat
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.benchmark.clustering import clustering
from api.cli.benchmark.cost import all_costs
from api.cli.benchmark.fit import fit
from api.cli.benchmark.live_latency import live
from api.cli.benchmark.profiles import profiles
from api.cli.benchmark.providers import providers
from api.cli.benchmark.tracking import tracking
from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, shows_help
from api.cli.options import checked, with_choices
from pipeline.core.runtime.child_processes import ProcessPool
from pipeline.run.engine.stage import DETECT
from worker.store.spec import JobSpec

if not shows_help():
    from api.cli.benchmark.long_takes import loop_video, peak_rss_mib
    from api.cli.client import Json
    from api.cli.served import served
    from pipeline.capture.session import open_session
    from pipeline.core.runtime.packages import samples
    from pipeline.core.runtime.packages.samples import Sample
    from pipeline.detection import models
    from pipeline.detection.network import NETWORK_CLOCK
    from pipeline.run.engine.local import reconstruct_to_files
    from pipeline.run.warm_up import warm_up

app = typer.Typer(help="Speed and memory.", no_args_is_help=True)
app.command("all")(all_costs)
app.command()(clustering)
app.command()(fit)
app.command()(live)
app.command()(profiles)
app.command()(providers)
app.command()(tracking)


@app.command()
@with_choices("profile", "joints", "detector")
def pipeline(
    *,
    loops: Annotated[int, typer.Option(min=1, max=100, help="Number of repetitions of the sample in its videos.")] = 1,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Time the sample capture from videos to result files in one process, compared with its networks alone."""
    with reporting(as_json), StageBars(visible=not as_json) as bars, tempfile.TemporaryDirectory() as folder:
        config = checked(chosen)
        models.install_networks(config)
        sample = samples.install()
        videos = list(sample.videos.values())
        if loops > 1:
            looped = [Path(folder) / path.name for path in videos]
            # In a child process, so that its memory does not count as the pipeline's.
            with ProcessPool(1) as pool:
                list(pool.map(loop_video, videos, looped, repeat(loops)))
            videos = looped
        warm_up()
        started_s = time.perf_counter()
        session = open_session(videos, sample.calibration)
        opened_s = time.perf_counter()
        before_s = NETWORK_CLOCK.total_s
        written = reconstruct_to_files(session, Path(folder) / "results", config, bars.update)
        network_s = NETWORK_CLOCK.total_s - before_s
        ended_s = time.perf_counter()
        num_bytes = sum(path.stat().st_size for path in written.paths)
        peak_mib = peak_rss_mib()
    wall_s = ended_s - started_s
    stages = {"open": opened_s - started_s, **bars.seconds}
    result = {
        "frames": sum(video.num_frames for video in session.videos),
        "stages": stages,
        "network_s": network_s,
        "wall_s": wall_s,
        "overhead": wall_s / network_s,
        "peak_rss_mib": peak_mib,
        "result_bytes": num_bytes,
    }
    if as_json:
        emit(result)
        return
    print_table(("stage", "seconds"), ((name, f"{seconds:.2f}") for name, seconds in stages.items()))
    typer.echo(
        f"{result['frames']} frames in {wall_s:.1f} s, the networks alone {network_s:.1f} s: "
        f"overhead {wall_s / network_s:.3f}, peak memory {peak_mib:.0f} MiB"
    )


def stage_seconds(job: "Json") -> dict[str, float]:
    """Seconds from the start of each stage's first chunk to the end of its last chunk."""
    return {
        stage["name"]: (
            datetime.fromisoformat(stage["finished_at"]) - datetime.fromisoformat(stage["started_at"])
        ).total_seconds()
        for stage in job["stages"]
    }


def time_service(sample: "Sample", workers: int, folder: Path) -> dict[str, Any]:
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


def time_library(sample: "Sample", folder: Path) -> float:
    """Time the library in one process, from the videos to the result files."""
    started_s = time.perf_counter()
    session = open_session(list(sample.videos.values()), sample.calibration)
    reconstruct_to_files(session, folder)
    return time.perf_counter() - started_s


@app.command()
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
