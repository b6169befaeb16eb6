"""`multicap benchmark`: speed and memory, as ratios within one run."""

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.benchmark.cost import all_costs
from api.cli.benchmark.fit import fit
from api.cli.benchmark.live_latency import live
from api.cli.benchmark.profiles import looped_sample, profiles
from api.cli.benchmark.providers import providers
from api.cli.benchmark.tracking import clustering, tracking
from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, shows_help
from api.cli.options import checked, with_choices

if not shows_help():
    from api.cli.benchmark.long_takes import peak_rss_mib
    from pipeline.capture.session import open_session
    from pipeline.core.runtime.packages import samples
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
        videos = looped_sample(sample, loops, Path(folder))
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
