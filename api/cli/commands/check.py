"""`multicap check`: what is wrong or doubtful about a session, before it is reconstructed."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli import console as terminal
from api.cli.commands.sync import all_bodies, measured_clocks
from api.cli.options import checked, with_choices
from api.cli.sources import SourceOptions, with_source
from pipeline.core.errors import InputError
from pipeline.core.findings import Finding, documents, from_problem, has_error
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import OnProgress, Progress
from pipeline.run.engine.stage import CHECK

if not terminal.shows_help():
    from api.cli.space import document, sentence, session_space
    from pipeline.capture.pictures.sample_pictures import look_at_pictures
    from pipeline.capture.session import CaptureSession, Session
    from pipeline.capture.synchronization.session_clocks import clock_findings, on_measured_clocks
    from pipeline.run.session_check.check_session import check_bodies, check_detections, with_clocks
    from pipeline.run.session_check.instants import check_at_instants
    from pipeline.run.session_check.sightings import NUM_INSTANTS
    from pipeline.run.session_check.verdict import session_findings


@with_choices("profile", "detector", "sync")
@with_source(omits=("clock",))
def command(
    *,
    calibration: Annotated[Path, typer.Option(help="Calibration file, see `multicap help formats`.")],
    source: SourceOptions,
    chosen: Mapping[str, Any],
    thumbnails: Annotated[
        Path | None,
        typer.Option(help="Folder for small copies of the pictures that are looked at.", show_default=False),
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Check a capture before its reconstruction: files, calibration, pictures, and people at twelve instants.

    With --sync auto the clocks are measured first, from people in all frames, and the people are checked on them.
    """
    with terminal.reporting(as_json):
        choices = checked(chosen, source.check)
        if thumbnails is not None:
            with terminal.writing(thumbnails):
                thumbnails.mkdir(parents=True, exist_ok=True)
        config = replace(choices, smoothing="none", sync="declared")
        try:
            session = source.open(calibration)
        except InputError as error:
            findings, space, layout = [from_problem(problem) for problem in error.problems], None, None
        else:
            space = session_space(session, choices)
            layout = session.layout
            of_pictures = _look(session, thumbnails) if isinstance(session, CaptureSession) else []
            with terminal.StageBars(visible=not as_json) as bars:
                people = (_on_measured_clocks if choices.sync == "auto" else _as_declared)(session, config, bars.update)
            findings = [
                *session.findings,
                *_once([*of_pictures, *session_findings(session.cameras, people)]),
            ]
    if as_json:
        terminal.emit(
            {
                "findings": documents(findings),
                "layout": None if layout is None else asdict(layout),
                "space": None if space is None else document(space),
            }
        )
    else:
        terminal.show_findings(findings, "Nothing is wrong with the capture.")
        terminal.show_layout(findings, layout)
        if space is not None:
            terminal.console.print(sentence(space))
    if has_error(findings):
        raise typer.Exit(terminal.EXIT_BAD_INPUT)


def _as_declared(session: "Session", config: ReconstructionConfig, on_progress: OnProgress) -> Sequence[Finding]:
    """Findings about people at a few instants of a session on its declared clocks."""
    if isinstance(session, CaptureSession):
        looked, total = itertools.count(1), NUM_INSTANTS * len(session.cameras)
        return check_at_instants(session, config, lambda: on_progress(Progress(CHECK, next(looked), total))).findings
    known = session, lambda frames: [session.detections], session.joints, session.stretches
    return with_clocks(check_detections(*known), *known).findings


def _on_measured_clocks(session: "Session", config: ReconstructionConfig, on_progress: OnProgress) -> Sequence[Finding]:
    """Findings about the clocks, and about people at a few instants if the clocks are certain."""
    detections, joints = all_bodies(session, config, on_progress)
    clocks = measured_clocks(session, detections, joints, on_progress)[0]
    findings = list(clock_findings(clocks))
    if clocks.is_certain:
        session = on_measured_clocks(session, clocks)
        findings += check_bodies(session, detections, joints, session.stretches).findings
    return findings


def _look(session: "CaptureSession", thumbnails: Path | None) -> Sequence[Finding]:
    """Check a few pictures of each camera, and write small copies of them."""
    with terminal.console.status("Look at pictures"):
        looked = look_at_pictures(session)
    if thumbnails is not None:
        with terminal.writing(thumbnails):
            for camera, of_camera in zip(session.cameras, looked.thumbnails, strict=True):
                for number, thumbnail in enumerate(of_camera):
                    (thumbnails / f"{camera.name}-{number}.jpg").write_bytes(thumbnail.content)
    return looked.findings


def _once(findings: Sequence[Finding]) -> list[Finding]:
    """Findings without those that repeat the code and the camera of an earlier one."""
    first = {(finding.code, finding.camera): finding for finding in reversed(findings)}
    return [finding for finding in findings if first[finding.code, finding.camera] is finding]
