"""`multicap evaluate`: accuracy against a known truth."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from api.console import StageBars, console, emit, reporting
from pipeline.config import ReconstructionConfig
from pipeline.metrics.datasets.rendered import load_rendered, score_rendered
from pipeline.run import reconstruct
from pipeline.session import open_session

app = typer.Typer(help="Accuracy against a known truth.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Accuracy against a known truth."""


@app.command()
def rendered(
    data: Annotated[Path, typer.Option(help="A folder with videos/, calibration.toml and gt.npz.")],
    detector: Annotated[str, typer.Option(help="See `multicap models list`.")] = "movenet-multipose",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Videos with exact truth: 12 body joints, Hungarian matching a frame, gate 0.5 m."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        truth = load_rendered(data)
        session = open_session(data / "videos", data / "calibration.toml")
        reconstruction = reconstruct(session, ReconstructionConfig(detector=detector), bars.update)
        scores = score_rendered(reconstruction.tracks, reconstruction.joints, reconstruction.timebase, truth)
    if as_json:
        emit(scores)
        return
    table = Table("measure", "value")
    for name, value in scores.items():
        table.add_row(name, "-" if value is None else f"{value:.4g}")
    console.print(table)
