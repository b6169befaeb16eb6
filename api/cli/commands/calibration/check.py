"""`multicap calibration check`: what is wrong or doubtful about a calibration, alone and with people."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import typer

from api.cli.commands.calibration.cameras import FileArgument, camera_documents, read
from api.cli.console import EXIT_BAD_INPUT, JsonOption, StageBars, emit, reporting, show_findings, show_layout, warn
from api.cli.options import checked, with_choices
from api.cli.sources import SourceOptions, with_source
from pipeline.calibration.checks.check import check_cameras
from pipeline.capture.session import Session
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError
from pipeline.core.findings import Finding, documents, from_problem, has_error
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.findings import CALIBRATION_NOTE
from pipeline.export.quality.findings import join_findings, people_findings
from pipeline.export.quality.report import quality_report
from pipeline.run.engine.local import reconstruct


@with_choices("profile", "detector")
@with_source(omits=("clock",))
def command(
    *,
    file: FileArgument,
    source: SourceOptions,
    chosen: Mapping[str, Any],
    as_json: JsonOption = False,
) -> None:
    """Check a calibration: lenses, places, unit, up axis and common views; with videos or keypoints also people."""
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        config = replace(checked(chosen, partial(source.check, is_optional=True)), smoothing="none")
        cameras: Sequence[Camera] = ()
        try:
            contents = read(file, source.units, source.up)
            cameras = contents.cameras
            session: Session | None = None
            if source.keypoints is not None or source.videos is not None:
                session = source.open(file)
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
    show_layout(session.layout, session.warnings)
    # Cameras of the session are those of the file at the size of the videos.
    fitted = {camera.name: camera for camera in session.cameras}
    alone = check_cameras([fitted.get(camera.name, camera) for camera in cameras])
    if has_error(alone):
        return alone
    reconstruction = reconstruct(session, replace(config, appearance="off", force=True), bars.update)
    return join_findings(alone, people_findings(quality_report(reconstruction)))
