"""`multicap sync`: measure the offsets of cameras by people and by sound."""

import json
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli import console
from api.cli.options import checked, with_choices
from api.cli.sources import SourceOptions, with_source
from pipeline.core.joints import JointSet
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.progress import OnProgress, Progress
from pipeline.run.engine.stage import SYNCHRONIZE

if not console.shows_help():
    from pipeline.capture.keypoints import KeypointSession
    from pipeline.capture.session import Session
    from pipeline.capture.synchronization.motions import excerpt
    from pipeline.capture.synchronization.report import error_pictures, sound_document, sync_document
    from pipeline.capture.synchronization.session_clocks import listen
    from pipeline.capture.synchronization.sound_offsets import SoundOffsets, synchronize_with_sound
    from pipeline.core.data.cameras import Synchronization
    from pipeline.core.data.detections import Detections
    from pipeline.detection.entries import detection_joints
    from pipeline.run.engine.local import detect_people

_REPORT = "sync.json"
_PERCENT = 100


@with_choices("profile", "detector")
@with_source(omits=("offset", "clock", "own_points"))
def command(
    *,
    calibration: Annotated[Path, typer.Option(help="Calibration file of the cameras.")],
    source: SourceOptions,
    chosen: Mapping[str, Any],
    report: Annotated[
        Path | None, typer.Option(help="Folder for sync.json, and a plot of each camera's error over its offset.")
    ] = None,
    as_json: console.JsonOption = False,
) -> None:
    """Measure when each camera started, and how fast its clock runs, from people who move.

    Session time is offset + rate * own time; the first camera's offset is 0. The exit code is 1 if the answer is not
    certain: the reasons say what to do.
    """
    with console.reporting(as_json), console.StageBars(visible=not as_json) as bars:
        config = checked(chosen, source.check)
        console.require_writable(report and report / _REPORT)
        session = source.open(calibration)
        detections, joints = all_bodies(session, config, bars.update)
        if not as_json:
            console.show_session(session.findings, session.layout)
        found, sound = measured_clocks(session, detections, joints, bars.update)
        document = sync_document(found) | {"sound": sound_document(sound)}
        if report is not None:
            files = {_REPORT: json.dumps(document, indent=1) + "\n", **error_pictures(found)}
            with console.writing(report):
                report.mkdir(parents=True, exist_ok=True)
                for name, text in files.items():
                    (report / name).write_text(text, encoding="utf-8")
    if as_json:
        console.emit(document)
    else:
        _show(document)
    if not document["certain"]:
        raise typer.Exit(console.EXIT_FAILED)


def _show(document: Mapping[str, Any]) -> None:
    console.print_table(
        ("camera", "offset", "standard deviation", "clock fast by"),
        (
            (
                camera,
                f"{offset:+.4f} s",
                "-" if (sigma := document["uncertainty_s"][camera]) is None else f"{1000 * sigma:.1f} ms",
                f"{1e6 * (1.0 - document['rates'][camera]):+.1f} ppm",
            )
            for camera, offset in document["offsets_s"].items()
        ),
    )
    for problem in (*document["refusals"], *document["warnings"]):
        where = f"{problem['camera']}: " if problem["camera"] else ""
        console.warn(f"{where}{problem['message']} {problem['hint'] or ''}".rstrip())
    if not document["certain"]:
        typer.echo("The offsets are not certain.")


def all_bodies(
    session: "Session", config: ReconstructionConfig, on_progress: OnProgress
) -> "tuple[Mapping[str, Detections], JointSet]":
    """Bodies in all frames of a session by camera, and their joints; those in videos are detected."""
    if isinstance(session, KeypointSession):
        return session.detections, session.joints
    return detect_people(session, config, on_progress), detection_joints(config)


def measured_clocks(
    session: "Session", detections: "Mapping[str, Detections]", joints: JointSet, on_progress: OnProgress
) -> "tuple[Synchronization, SoundOffsets]":
    """Clocks from the motion of the bodies and the sound of the videos, and what the sound alone told."""
    sound = listen(session, lambda camera: nullcontext())
    found = synchronize_with_sound(
        session.cameras,
        session.times,
        excerpt(session.times, detections),
        joints,
        session.starts_s,
        sound,
        lambda share: on_progress(Progress(SYNCHRONIZE, round(_PERCENT * share), _PERCENT)),
    )
    return found, sound
