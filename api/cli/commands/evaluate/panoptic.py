"""`multicap evaluate panoptic`: accuracy on a sequence of CMU Panoptic."""

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
    from pipeline.validation.evaluation.datasets import panoptic
    from pipeline.validation.evaluation.datasets.footage import frame_times


@with_choices("frame_range", "profile", "detector", "method", "smoothing", "joint_centers", "refine_calibration")
def command(
    *,
    data: Annotated[Path, typer.Option(help="The folder of a sequence as the data set's toolbox makes it.")],
    cameras: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="HD cameras, such as 00_03,00_06. Default: the five of VoxelPose."),
    ] = None,
    every: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, help="Compare with every n-th file of poses. Default: as VoxelPose."),
    ] = None,
    keypoints: KeypointsOption = None,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """A sequence of CMU Panoptic: errors of 15 joints, AP at 25 to 150 mm and recall by VoxelPose's protocol."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        config = replace(checked(chosen), force=True)
        names = panoptic.CAMERAS if cameras is None else tuple(filter(None, map(str.strip, cameras.split(","))))
        sequence = panoptic.load_panoptic(data, names, every or panoptic.EVERY, has_footage=keypoints is None)
        has_videos = bool(sequence.footage) and not any(path.is_dir() for path in sequence.footage)
        rate_hz = None if has_videos else panoptic.FRAME_RATE_HZ  # a folder of images states none
        source = SourceOptions(list(sequence.footage), keypoints=keypoints, frame_rate=rate_hz)
        session = source.open(sequence.calibration)
        take = reconstruct(session, config, bars.update)
        scores = panoptic.score_panoptic(
            take.tracks, take.joints, take.timebase, sequence, frame_times(session, sequence.first_image)
        )
    print_scores(scores, as_json)
