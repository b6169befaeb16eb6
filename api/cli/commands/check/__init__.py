"""`multicap check`: what is wrong or doubtful about a session, before it is reconstructed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.progress import Progress

from api.cli.commands.calibration.cameras import JsonOption, UnitsOption
from api.cli.commands.reconstruct import check_sources, parameters
from api.cli.console import EXIT_BAD_INPUT, console, emit, reporting, show_findings
from api.cli.options import (
    DEFAULTS,
    DetectorOption,
    KeypointRateOption,
    KeypointsOption,
    ProfileOption,
    TimestampsOption,
    known,
    known_units,
)
from pipeline.calibration.checks.check import check_cameras
from pipeline.capture.keypoints import open_keypoints
from pipeline.capture.pictures import look_at_pictures
from pipeline.capture.session import CaptureSession, Recording, open_session
from pipeline.config import CHOICES, Profile, ReconstructionConfig
from pipeline.errors import InputError
from pipeline.findings import Finding, documents, from_problem, has_error
from pipeline.preflight.sightings import NUM_INSTANTS
from pipeline.quality.findings import join_findings
from pipeline.stages.association import Session
from pipeline.stages.cameras.checking import check_at_instants


def command(
    *,
    calibration: Annotated[Path, typer.Option(help="Calibration file, see docs/formats.md.")],
    videos: Annotated[
        list[Path] | None, typer.Option(help="Folder with one video of each camera, or the videos.", show_default=False)
    ] = None,
    offset: Annotated[
        list[str] | None,
        typer.Option(metavar="CAMERA=SECONDS", help="Time of a video's first frame on the common clock; repeatable."),
    ] = None,
    keypoints: KeypointsOption = None,
    timestamps: TimestampsOption = None,
    frame_rate: KeypointRateOption = None,
    units: UnitsOption = "m",
    profile: ProfileOption = DEFAULTS.profile,
    detector: DetectorOption = DEFAULTS.detector,
    thumbnails: Annotated[
        Path | None,
        typer.Option(help="Folder for small copies of the pictures that are looked at.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check a session before its reconstruction: files, calibration, pictures, and people at twelve instants."""
    with reporting(as_json):
        offsets = parameters(offset or [], "cam_2=0.48")
        check_sources(videos, keypoints, timestamps, offsets)
        config = ReconstructionConfig(
            detector=detector, profile=cast(Profile, known(CHOICES["profile"], profile)), smoothing="none"
        )
        unit = known_units(units)
        try:
            session: Session
            if keypoints is not None:
                session = open_keypoints(keypoints, calibration, timestamps, frame_rate, unit)
            else:
                paths = videos or []
                recordings = [Recording(camera, offset_s=seconds) for camera, seconds in offsets.items()]
                session = open_session(paths[0] if len(paths) == 1 else paths, calibration, recordings, unit)
        except InputError as error:
            findings = [from_problem(problem) for problem in error.problems]
        else:
            findings = _check(session, config, thumbnails, as_json)
    if as_json:
        emit({"findings": documents(findings)})
    else:
        show_findings(findings, "Nothing is wrong with the session.")
    if has_error(findings):
        raise typer.Exit(EXIT_BAD_INPUT)


def _check(session: Session, config: ReconstructionConfig, thumbnails: Path | None, as_json: bool) -> list[Finding]:
    """Findings of the files, of the pictures, of the calibration, and of the people."""
    of_pictures = _look(session, thumbnails) if isinstance(session, CaptureSession) else []
    with Progress(console=console, disable=as_json, transient=True) as progress:
        task = progress.add_task("Look at people", total=NUM_INSTANTS * len(session.cameras))
        check = check_at_instants(session, config, lambda: progress.advance(task))
    return [*session.findings, *_once([*of_pictures, *join_findings(check_cameras(session.cameras), check.findings)])]


def _look(session: CaptureSession, thumbnails: Path | None) -> Sequence[Finding]:
    """Check a few pictures of each camera, and write small copies of them."""
    with console.status("Look at pictures"):
        looked = look_at_pictures(session)
    if thumbnails is not None:
        thumbnails.mkdir(parents=True, exist_ok=True)
        for camera, of_camera in zip(session.cameras, looked.thumbnails, strict=True):
            for number, one in enumerate(of_camera):
                (thumbnails / f"{camera.name}-{number}.jpg").write_bytes(one.content)
    return looked.findings


def _once(findings: Sequence[Finding]) -> list[Finding]:
    """Findings without those that repeat the code and the camera of an earlier one."""
    first = {(one.code, one.camera): one for one in reversed(findings)}
    return [one for one in findings if first[one.code, one.camera] is one]
