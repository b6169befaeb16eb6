"""`multicap calibration check`: what is wrong or doubtful about a calibration, alone and with people."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import typer

from api.cli.commands.calibration.cameras import FileArgument, camera_documents, read
from api.cli.console import EXIT_BAD_INPUT, JsonOption, StageBars, emit, reporting, show_findings, warn
from api.cli.options import (
    KeypointRateOption,
    KeypointsOption,
    PairByOrderOption,
    TimestampsOption,
    UnitsOption,
    UpOption,
    checked,
    known_units,
    known_up,
    with_choices,
)
from api.cli.sources import OffsetOption, RateOption, VideosOption, check_sources, open_source
from pipeline.calibration.checks.check import check_cameras
from pipeline.capture.session import Session
from pipeline.config import ReconstructionConfig
from pipeline.data.cameras import Camera
from pipeline.errors import InputError
from pipeline.findings import Finding, documents, from_problem, has_error
from pipeline.problem_codes.findings import CALIBRATION_NOTE
from pipeline.quality.findings import join_findings, people_findings
from pipeline.quality.report import quality_report
from pipeline.stages.local import reconstruct


@with_choices("profile", "detector")
def command(
    *,
    file: FileArgument,
    videos: VideosOption = None,
    offset: OffsetOption = None,
    rate: RateOption = None,
    keypoints: KeypointsOption = None,
    timestamps: TimestampsOption = None,
    frame_rate: KeypointRateOption = None,
    pair_by_order: PairByOrderOption = False,
    units: UnitsOption = None,
    up: UpOption = "z",
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Check a calibration: lenses, places, unit, up axis and common views; with videos or keypoints also people."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        if any((videos, keypoints, timestamps, offset, rate)):
            check_sources(videos, keypoints, timestamps, offset, rate)
        config = replace(checked(chosen), smoothing="none")
        unit, axis = known_units(units), known_up(up)
        cameras: Sequence[Camera] = ()
        try:
            contents = read(file, units, up)
            cameras = contents.cameras
            session: Session | None = None
            if keypoints is not None or videos is not None:
                session = open_source(
                    videos,
                    keypoints,
                    file,
                    timestamps,
                    offset,
                    rate,
                    unit,
                    frame_rate=frame_rate,
                    pair_by_order=pair_by_order,
                    up=axis,
                )
        except InputError as error:
            findings = [*check_cameras(cameras)] if cameras else []
            findings += [from_problem(problem) for problem in error.problems]
        else:
            findings = _check(cameras, session, config, bars)
            if session is None:
                findings += [Finding(CALIBRATION_NOTE, note, severity="info") for note in contents.notes]
    if as_json:
        emit({"cameras": camera_documents(cameras), "findings": documents(findings)})
    else:
        show_findings(findings, f"{len(cameras)} cameras: nothing is wrong with the calibration.")
    if has_error(findings):
        raise typer.Exit(EXIT_BAD_INPUT)


def _check(
    cameras: Sequence[Camera], session: Session | None, config: ReconstructionConfig, bars: StageBars
) -> list[Finding]:
    if session is None:
        return check_cameras(cameras)
    for sentence in session.warnings:
        warn(sentence)
    # Cameras of the session are those of the file at the size of the videos.
    fitted = {camera.name: camera for camera in session.cameras}
    alone = check_cameras([fitted.get(camera.name, camera) for camera in cameras])
    if has_error(alone):
        return alone
    reconstruction = reconstruct(session, replace(config, appearance="off", force=True), bars.update)
    return join_findings(alone, people_findings(quality_report(reconstruction)))
