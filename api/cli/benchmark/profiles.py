"""`multicap benchmark profiles`: time of each profile on the sample capture, compared with one network alone."""

import tempfile
import time
from itertools import repeat
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.console import JsonOption, console, emit, print_table, reporting, shows_help
from pipeline.core.options.config import JOINTS, PROFILES, Detector, ReconstructionConfig
from pipeline.core.runtime.child_processes import ProcessPool

if not shows_help():
    from api.cli.benchmark.long_takes import loop_video
    from pipeline.capture.session import open_session
    from pipeline.core.runtime.packages import samples
    from pipeline.core.runtime.packages.samples import Sample
    from pipeline.detection import models
    from pipeline.detection.network import NETWORK_CLOCK
    from pipeline.run.engine.local import reconstruct_to_files
    from pipeline.run.warm_up import warm_up

_REFERENCE: Detector = "movenet-multipose"


def configurations() -> dict[str, ReconstructionConfig]:
    """Configurations that are compared, by name; the first one is MoveNet MultiPose alone at its usual size."""
    return {
        _REFERENCE: ReconstructionConfig(detector=_REFERENCE),
        **{
            f"{profile} {joints}": ReconstructionConfig(profile=profile, joints=joints)
            for profile in PROFILES
            for joints in JOINTS
        },
    }


def profiles(
    loops: Annotated[int, typer.Option(min=1, max=100, help="Number of repetitions of the sample in its videos.")] = 1,
    rounds: Annotated[int, typer.Option(min=1, max=20, help="Number of jobs of each profile, by turns.")] = 1,
    only: Annotated[str | None, typer.Option(help="Part of the names of the profiles to measure.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Time whole jobs of every profile and joint set by turns, from the sample's videos to result files."""
    with reporting(as_json), tempfile.TemporaryDirectory() as folder:
        compared = {
            name: config for name, config in configurations().items() if name == _REFERENCE or (only or "") in name
        }
        for config in compared.values():
            models.install_networks(config)
        sample = samples.install()
        videos = looped_sample(sample, loops, Path(folder))
        warm_up()
        measured: dict[str, list[dict[str, float]]] = {name: [] for name in compared}
        for _ in range(rounds):
            for name, config in compared.items():
                measured[name].append(_time_job(videos, sample.calibration, config, Path(folder) / "results"))
                console.print(f"{name}: {measured[name][-1]['job_s']:.1f} s")
    best = {name: min(jobs, key=lambda job: job["job_s"]) for name, jobs in measured.items()}
    result = {name: _compared(job, best[_REFERENCE]) for name, job in best.items()}
    if as_json:
        emit(result)
        return
    names = tuple(result[_REFERENCE])
    print_table(("profile", *names), ((name, *(f"{row[key]:.2f}" for key in names)) for name, row in result.items()))


def looped_sample(sample: "Sample", loops: int, folder: Path) -> list[Path]:
    """Videos of the sample, repeated; made in a child process, so that its memory does not count."""
    videos = list(sample.videos.values())
    if loops == 1:
        return videos
    looped = [folder / path.name for path in videos]
    with ProcessPool(1) as pool:
        list(pool.map(loop_video, videos, looped, repeat(loops)))
    return looped


def _time_job(videos: list[Path], calibration: Path, config: ReconstructionConfig, results: Path) -> dict[str, float]:
    """Time a job in this process: seconds of the whole and of its networks, and passes of the networks."""
    started_s = time.perf_counter()
    network_s, passes = NETWORK_CLOCK.total_s, NETWORK_CLOCK.num_passes
    reconstruct_to_files(open_session(videos, calibration), results, config)
    return {
        "job_s": time.perf_counter() - started_s,
        "network_s": NETWORK_CLOCK.total_s - network_s,
        "passes": float(NETWORK_CLOCK.num_passes - passes),
    }


def _compared(job: dict[str, float], reference: dict[str, float]) -> dict[str, Any]:
    return job | {
        "job_ratio": reference["job_s"] / job["job_s"],
        "network_ratio": reference["network_s"] / job["network_s"],
    }
