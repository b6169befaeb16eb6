"""`multicap calibration`: show, check and convert calibration files, and plan a rig."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli import console as terminal
from api.cli import options
from api.cli.sources import SourceOptions, with_source
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.findings import Finding, documents, from_problem, has_error
from pipeline.core.options.config import ReconstructionConfig
from pipeline.core.problems.finding_codes import CALIBRATION_NOTE, PARAMETER_UNREADABLE
from pipeline.core.problems.session_codes import CALIBRATION_FORMAT, CAMERA_UNKNOWN, INVALID_SIZE

if not terminal.shows_help():
    import numpy as np

    from pipeline.calibration.checks.camera_checks import check_cameras
    from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
    from pipeline.calibration.program_files import PROGRAM_FORMATS, refusals
    from pipeline.calibration.registry import read_contents
    from pipeline.calibration.room_plan import plan_document, plan_room, plan_svg, planned_cameras
    from pipeline.capture.session import Session
    from pipeline.core.data.cameras import Camera
    from pipeline.core.parsing import SIDE_PX, Quantity
    from pipeline.export.quality.report import join_findings, people_findings, quality_report
    from pipeline.geometry.camera import center_in_world
    from pipeline.run.engine.local import reconstruct

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Calibration in any supported format.")]

app = typer.Typer(help="Calibration files: show, check, convert; plan of a rig.", no_args_is_help=True)


@app.command()
def show(file: FileArgument, units: options.UnitsOption = None, as_json: terminal.JsonOption = False) -> None:
    """Show the format, the unit and the cameras of a calibration."""
    with terminal.reporting(as_json):
        contents = read(file, units)
    if as_json:
        terminal.emit(_document(contents, units))
        return
    _show_statement(contents, units)
    terminal.print_table(
        ("camera", "size", "focal length", "principal point", "distortion", "position"),
        ([*_cells(camera)] for camera in contents.cameras),
    )


@app.command()
def convert(
    file: FileArgument,
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="File to write.")],
    to: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Format: multicap, anipose, caliscope, opencv, freemocap, qca, opencap, easymocap, colmap, kalibr, "
            "mamma. Default: by the ending of TARGET.",
        ),
    ] = None,
    units: options.UnitsOption = None,
    up: options.UpOption = "z",
    size: options.SizeOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Write a calibration for Multicap or another program, with Z up where the format has no axes of its own."""
    with terminal.reporting(as_json):
        contents = read(file, units, up)
        contents, problems = _sized(file, contents, size or ())
        name, of_target = _target_format(target, to)
        problems += of_target
        if name is not None:
            problems += refusals(name, contents.cameras, target.name)
        if problems or name is None:
            raise InputError(problems)
        with terminal.writing(target.name):
            target.write_bytes(PROGRAM_FORMATS[name].encode(contents.cameras))
    if as_json:
        terminal.emit(_document(contents, units) | {"file": str(target)})
        return
    _show_statement(contents, units)
    terminal.console.print(f"{len(contents.cameras)} cameras in {target}")


def _target_format(target: Path, stated: str | None) -> tuple[str | None, list[Problem]]:
    """Name of the format of a file to write, ``None`` if there is none; and a problem of the format or the ending."""
    file = target.name.lower()
    by_ending = [name for name, known in PROGRAM_FORMATS.items() if file.endswith(known.endings)]
    # Several formats of programs are zip archives.
    name = by_ending[0] if stated is None and by_ending and not file.endswith(".zip") else stated
    if name in by_ending:
        return name, []
    if name is not None and name in PROGRAM_FORMATS:
        title, endings = PROGRAM_FORMATS[name][:2]
        message, hint = f"{title} is not read from a file of this ending.", f"Use {' or '.join(endings)}."
    else:
        message = "The ending does not tell the format." if name is None else f"There is no format {name[:40]!r}."
        hint = f"State one by --to: {', '.join(by_ending or PROGRAM_FORMATS)}."
    return None, [Problem(CALIBRATION_FORMAT, message, file=target.name, hint=hint)]


def _sized(file: Path, contents: "CameraFile", stated: Sequence[str]) -> "tuple[CameraFile, list[Problem]]":
    """Give cameras the stated sizes; report wrong statements, and cameras without a size."""
    sizes_px, problems = options.stated_sizes(stated)
    names = {camera.name for camera in contents.cameras}
    for name in sizes_px.keys() - names - {""}:
        hint = f"The file has {listed_names(sorted(names))}."
        problems.append(Problem(CAMERA_UNKNOWN, "The file has no camera of this name.", file.name, name, hint=hint))
    cameras = []
    for camera in contents.cameras:
        size_px = sizes_px.get(camera.name, sizes_px.get("", camera.size_px))
        if camera.size_px not in (UNKNOWN_SIZE, size_px):
            message = f"The calibration contains the size of the picture, {camera.size_px[0]} x {camera.size_px[1]}."
            problems.append(Problem(INVALID_SIZE, message, file.name, camera.name, "size", "Omit --size."))
        elif size_px == UNKNOWN_SIZE:
            message = "The calibration does not contain the size of the picture."
            hint = "State it: --size 1920x1080, or --size CAMERA=1920x1080 for each camera."
            problems.append(Problem(INVALID_SIZE, message, file.name, camera.name, "size", hint))
        cameras.append(replace(camera, size_px=size_px))
    return replace(contents, cameras=tuple(cameras)), problems


def _show_statement(contents: "CameraFile", units: str | None) -> None:
    stated = f"{units}, as stated by --units" if units else "m, as neither the format nor --units states"
    unit = f"{contents.unit}, by the format" if contents.unit else stated
    terminal.console.print(f"{contents.format}; lengths in the file: {unit}; axes: {contents.axes}")
    for note in contents.notes:
        terminal.warn(note)


def _cells(camera: "Camera") -> list[str]:
    width, height = camera.size_px
    (fx, _, cx), (_, fy, cy), _ = camera.matrix.tolist()
    position = ", ".join(f"{value:.3f}" for value in center_in_world(camera))
    return [
        camera.name,
        "unknown" if camera.size_px == UNKNOWN_SIZE else f"{width} x {height}",
        f"{fx:.1f}, {fy:.1f} px",
        f"{cx:.1f}, {cy:.1f} px",
        " ".join([*(["fisheye"] * (camera.lens == "fisheye")), *(f"{value:.4g}" for value in camera.distortion)]),
        f"{position} m",
    ]


def _document(contents: "CameraFile", units: str | None) -> dict[str, Any]:
    return {
        "format": contents.format,
        "units": contents.unit or units or "m",
        "axes": contents.axes,
        "warnings": documents(_notes(contents)),
        "cameras": camera_documents(contents.cameras),
    }


def _notes(contents: "CameraFile") -> list[Finding]:
    return [Finding(CALIBRATION_NOTE, note, severity="info") for note in contents.notes]


@app.command()
@options.with_choices("profile", "detector")
@with_source(omits=("clock", "own_points"))
def check(
    *,
    file: FileArgument,
    source: SourceOptions,
    chosen: Mapping[str, Any],
    as_json: terminal.JsonOption = False,
) -> None:
    """Check a calibration: lenses, places, unit, up axis and common views; with videos or keypoints also people."""
    with terminal.reporting(as_json), terminal.StageBars(visible=not as_json) as bars:
        config = replace(options.checked(chosen, partial(source.check, is_optional=True)), smoothing="none")
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
                findings += _notes(contents)
    if as_json:
        terminal.emit({"cameras": camera_documents(cameras), "findings": documents(findings)})
    else:
        terminal.show_findings(findings, f"{len(cameras)} cameras: nothing is wrong with the calibration.")
    if has_error(findings):
        raise typer.Exit(terminal.EXIT_BAD_INPUT)


def _check(
    cameras: "Sequence[Camera]", session: "Session | None", config: ReconstructionConfig, bars: terminal.StageBars
) -> list[Finding]:
    if session is None:
        return check_cameras(cameras)
    terminal.show_session(session.findings, session.layout)
    # The session has the cameras of the file, at the size of the videos.
    fitted = {camera.name: camera for camera in session.cameras}
    alone = check_cameras([fitted.get(camera.name, camera) for camera in cameras])
    if has_error(alone):
        return alone
    reconstruction = reconstruct(session, replace(config, appearance="off", force=True), bars.update)
    return join_findings(alone, people_findings(quality_report(reconstruction)))


@app.command()
def plan(
    room: Annotated[str, typer.Option(metavar="XxY", help="Sides of the floor in metres, such as 8x6.")],
    cameras: Annotated[int, typer.Option(help="Number of cameras, evenly along the walls.")] = 4,
    height: Annotated[float, typer.Option(help="Height of the cameras in metres.")] = 2.5,
    fov: Annotated[float, typer.Option(help="Horizontal field of view of the cameras in degrees.")] = 70.0,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the pictures.")] = "1920x1080",
    calibration: Annotated[
        Path | None, typer.Option(help="Cameras that stand already; the room's middle is their origin.")
    ] = None,
    people: Annotated[int, typer.Option(help="Number of people in the room.")] = 1,
    out: Annotated[Path | None, typer.Option(help="SVG picture to write.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Plan a rig: which part of a room it covers, how many cameras see a joint, and the expected error by place."""
    with terminal.reporting(as_json):
        room_m, size_px = (tuple(map(float, re.findall(r"\d+(?:\.\d+)?", text))) for text in (room, size))
        stated = {
            "room": (room_m if len(room_m) == 2 else (), Quantity(1, 100, "m")),
            "cameras": ((cameras,), Quantity(2, 128, "cameras")),
            "height": ((height,), Quantity(0.1, 50, "m")),
            "fov": ((fov,), Quantity(10, 150, "degrees")),
            "size": (size_px if len(size_px) == 2 else (), SIDE_PX),
            "people": ((people,), Quantity(1, 100, "people")),
        }
        if problems := [
            Problem(PARAMETER_UNREADABLE, f"--{name} must be {allowed}.", field=name)
            for name, (numbers, allowed) in stated.items()
            if not numbers or not allowed.holds(np.array(numbers))
        ]:
            raise InputError(problems)
        floor_m, sides_px = (room_m[0], room_m[1]), (int(size_px[0]), int(size_px[1]))
        if calibration is None:
            rig = planned_cameras(floor_m, cameras, height, sides_px, fov)
        else:
            contents, problems = _sized(calibration, read(calibration, None), ())
            if problems:
                raise InputError(problems)
            rig = contents.cameras
        found = plan_room(rig, floor_m, people)
        if out is not None:
            with terminal.writing(out.name):
                out.write_text(plan_svg(found, rig, floor_m), encoding="utf-8")
    document = plan_document(found)
    if as_json:
        terminal.emit(document | {"cameras": camera_documents(rig)})
        return
    terminal.print_table(
        ("x, m", "y, m", "views", "error, mm"), (list(map(str, place.values())) for place in document["places"])
    )
    terminal.console.print(f"{100 * found.covered:.0f} % of the floor: every joint is expected in two views or more.")


def read(file: Path, units: str | None, up: str = "z") -> "CameraFile":
    """Read a calibration in a unit, and with an axis that points up, as they were typed.

    Raises ``InputError`` if there is no such unit or axis, or with all problems of the file.
    """
    return read_contents(file, options.known_units(units), options.known_up(up))


def camera_documents(cameras: "Sequence[Camera]") -> list[dict[str, Any]]:
    """Cameras as JSON objects; lengths in metres."""
    return [
        {
            "name": camera.name,
            "size_px": None if camera.size_px == UNKNOWN_SIZE else list(camera.size_px),
            "matrix": camera.matrix.tolist(),
            "lens": camera.lens,
            "distortion": camera.distortion.tolist(),
            "rotation": camera.cam_from_world.rotation.tolist(),
            "translation_m": camera.cam_from_world.translation_m.tolist(),
            "position_m": np.round(center_in_world(camera), 6).tolist(),
        }
        for camera in cameras
    ]
