"""`multicap evaluate campus`, and Shelf from pictures or keypoints: scores of the actors of a published folder."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.shared import shown
from api.cli.console import JsonOption, StageBars, emit, print_table, reporting, shows_help
from api.cli.options import KeypointsOption, checked, with_choices
from api.cli.sources import SourceOptions
from pipeline.core.options.config import ReconstructionConfig

if not shows_help():
    import numpy as np

    from pipeline.run.engine.local import reconstruct
    from pipeline.validation.evaluation.datasets import actors


@with_choices("profile", "detector", "method", "smoothing", "joint_centers", "refine_calibration")
def command(
    *,
    data: Annotated[
        Path, typer.Option(help="The published folder: actorsGT.mat, a calibration, Camera0, Camera1, ...")
    ],
    keypoints: KeypointsOption = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """The Campus benchmark: PCP of images 350-470 and 650-750, mean over actors 1-3, in percent."""
    with reporting(as_json):
        evaluate_actors("campus", data, keypoints, checked(chosen), as_json)


def evaluate_actors(
    dataset: str, data: Path, keypoints: list[Path] | None, config: ReconstructionConfig, as_json: bool
) -> None:
    """Reconstruct the tested images of a published folder; print the scores of its actors."""
    with StageBars(visible=not as_json) as bars:
        sequence = actors.load_actors(data, dataset, has_footage=keypoints is None)
        footage, rate_hz = list(sequence.footage), actors.FRAME_RATE_HZ
        source = SourceOptions(footage, keypoints=keypoints, frame_rate=rate_hz, pair_by_order=True)
        session = source.open(sequence.calibration)
        frames = actors.tested_frames(session, sequence)
        take = reconstruct(session, replace(config, force=True, frame_range=frames), bars.update)
    scored = np.arange(take.timebase.num_frames)
    scores = {"method": config.method, **actors.score_actors(take.tracks, take.joints, scored, sequence.truth_m)}
    if as_json:
        emit(scores)
        return
    print_actors(scores)


def print_actors(scores: Mapping[str, Any]) -> None:
    """Print PCP by part and actor, and errors by actor."""
    pcp = scores["pcp"]
    parts = [*pcp["parts"].items(), ("all", pcp["actors"])]
    columns = ["part", *(f"actor {number + 1}" for number in range(len(pcp["actors"])))]
    print_table(columns, ([name, *(f"{value:.2f}" for value in values)] for name, values in parts))
    rules = ", ".join(f"{rule} {value:.2f}" for rule, value in pcp["by_head_rule"].items())
    by_actor = zip(scores["mpjpe_mm"], scores["pck150"], strict=True)
    typer.echo(
        f"Average PCP {pcp['average']:.2f} % (by head rule: {rules})\nMPJPE and PCK150 by actor: "
        + "; ".join(f"{shown(mpjpe_mm)} mm, {pck150:.2f} %" for mpjpe_mm, pck150 in by_actor)
        + f"\nIdentity switches {scores['switches']}"
    )
