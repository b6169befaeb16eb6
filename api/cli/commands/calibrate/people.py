"""`multicap calibrate people`: cameras from people who walk about."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.calibrate.written import POINTS_HELP, require_outputs, show_made, write_made
from api.cli.console import JsonOption, StageBars, reporting, show_layout, warn
from api.cli.options import checked, with_choices
from api.cli.sources import SourceOptions, with_source
from pipeline.calibration.known_points.table import read_known_points
from pipeline.calibration.people.calibrate import calibrate_people
from pipeline.capture.keypoints import KeypointSession
from pipeline.capture.session import CaptureSession
from pipeline.core.errors import InputError, Problem
from pipeline.core.options.job_choices import MAX_STATURE_M, MAX_STATURES, MIN_STATURE_M
from pipeline.core.problems.findings import SOURCES
from pipeline.core.progress import Progress
from pipeline.detection.profiles.detection import detection_joints
from pipeline.run.engine.local import detect_people
from pipeline.run.engine.stage import CALIBRATE

_PERCENT = 100


@with_choices("profile", "detector")
@with_source(omits=("clock", "units", "up"))
def command(
    *,
    stature_m: Annotated[
        list[float],
        typer.Option(
            "--stature-m",
            min=MIN_STATURE_M,
            max=MAX_STATURE_M,
            metavar="M",
            help="Stature of the people in metres; may be given once for each person.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="Calibration to write: .json, .toml or .yml.")],
    source: SourceOptions,
    intrinsics: Annotated[
        Path | None,
        typer.Option(
            help="Calibration whose intrinsics are kept; its poses are ignored. Default: focal lengths are estimated."
        ),
    ] = None,
    world_points: Annotated[Path | None, typer.Option(help=POINTS_HELP)] = None,
    chosen: Mapping[str, Any],
    report: Annotated[Path | None, typer.Option(help="Folder for the report.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate cameras from people of known stature who walk about: no board."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        require_outputs(out, report)
        known_points = read_known_points(world_points) if world_points is not None else ()
        config = checked(chosen, source.check)
        _check_sources(source.keypoints, intrinsics, stature_m)
        session: CaptureSession | KeypointSession
        if source.keypoints is not None and intrinsics is not None:
            session = source.open_keypoints(intrinsics, keeps_poses=False)
            detections, joints = session.detections, session.joints
        else:
            session = source.open_videos(intrinsics, keeps_poses=False)
            detections = detect_people(session, config, bars.update, has_poses=False)
            joints = detection_joints(config)
        for sentence in () if as_json else session.warnings:
            warn(sentence)
        if not as_json:
            show_layout(session.layout, session.warnings)
        made = calibrate_people(
            session.cameras,
            session.times,
            detections,
            joints,
            stature_m,
            intrinsics is not None,
            lambda share: bars.update(Progress(CALIBRATE, round(_PERCENT * share), _PERCENT)),
            known_points,
        )
        write_made(made, out, report)
    show_made(made, out, as_json)


def _check_sources(keypoints: Sequence[Path] | None, intrinsics: Path | None, stature_m: list[float]) -> None:
    problems = []
    if keypoints is not None and intrinsics is None:
        message = "Keypoints don't tell the size of the pictures."
        problems.append(Problem(SOURCES, message, hint="Give --intrinsics too."))
    if len(stature_m) > MAX_STATURES:
        problems.append(Problem(SOURCES, f"At most {MAX_STATURES} statures are taken.", field="stature_m"))
    if problems:
        raise InputError(problems)
