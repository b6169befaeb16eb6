"""`multicap evaluate human36m`: accuracy on an action of Human3.6M."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.evaluate.shared import print_scores
from api.cli.console import JsonOption, StageBars, reporting, shows_help
from api.cli.options import KeypointsOption, checked, with_choices
from api.cli.sources import SourceOptions

if not shows_help():
    from pipeline.run.engine.local import reconstruct
    from pipeline.validation.evaluation.datasets import human36m
    from pipeline.validation.evaluation.datasets.footage import frame_times


@with_choices("frame_range", "profile", "detector", "method", "smoothing", "joint_centers", "refine_calibration")
def command(
    *,
    data: Annotated[Path, typer.Option(help="The folder of a subject, such as S9.")],
    action: Annotated[str, typer.Option(help='Name of the action\'s files, such as "Directions 1".')],
    calibration: Annotated[Path, typer.Option(help="The cameras of the subject: camera-parameters-S9.json.")],
    keypoints: KeypointsOption = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """An action of Human3.6M: errors of 13 joints, as they are and after Procrustes."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        config = replace(checked(chosen), force=True)
        videos, truth_m = human36m.load_human36m(data, action, has_footage=keypoints is None)
        rate_hz = human36m.FRAME_RATE_HZ if keypoints else None
        session = SourceOptions(list(videos), keypoints=keypoints, frame_rate=rate_hz).open(calibration)
        take = reconstruct(session, config, bars.update)
        times = frame_times(session, 0)
        scores = human36m.score_human36m(take.tracks, take.joints, take.timebase, truth_m, times)
    print_scores(scores, as_json)
