"""`multicap calibration`: show, check and convert calibration files."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from api.cli.commands.calibration import check
from api.cli.commands.calibration.cameras import FileArgument, camera_documents, read
from api.cli.console import JsonOption, console, emit, print_table, reporting, warn, writing
from api.cli.options import UnitsOption, UpOption
from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.write import ENCODERS
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem, listed_names
from pipeline.core.parsing import SIDE_PX
from pipeline.core.problems.findings import PARAMETER_UNREADABLE
from pipeline.core.problems.sessions import CALIBRATION_FORMAT, CAMERA_UNKNOWN, INVALID_SIZE
from pipeline.geometry.camera import center_in_world

app = typer.Typer(help="Calibration files: show, check, convert.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Calibration files: show, check, convert."""


@app.command()
def show(file: FileArgument, units: UnitsOption = None, as_json: JsonOption = False) -> None:
    """Show the format, the unit and the cameras of a calibration."""
    with reporting(as_json):
        contents = read(file, units)
    if as_json:
        emit(_document(contents, units))
        return
    _show_statement(contents, units)
    print_table(
        ("camera", "size", "focal length", "principal point", "distortion", "position"),
        ([*_cells(camera)] for camera in contents.cameras),
    )


@app.command()
def convert(
    file: FileArgument,
    target: Annotated[Path, typer.Argument(metavar="TARGET", help=f"File to write: {', '.join(ENCODERS)}.")],
    units: UnitsOption = None,
    up: UpOption = "z",
    size: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WIDTHxHEIGHT|CAMERA=WIDTHxHEIGHT",
            help="Size of the pictures, where the calibration does not contain it: of all cameras, or of one; "
            "repeatable.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a calibration as Multicap's JSON, anipose's TOML or OpenCV's YAML, in metres and with Z up."""
    with reporting(as_json):
        contents = read(file, units, up)
        contents, problems = _sized(file, contents, size or ())
        if target.suffix.lower() not in ENCODERS:
            hint = f"Use one of {', '.join(ENCODERS)}."
            problems.append(Problem(CALIBRATION_FORMAT, "This ending is not supported.", file=target.name, hint=hint))
        if problems:
            raise InputError(problems)
        with writing(target.name):
            target.write_bytes(ENCODERS[target.suffix.lower()](contents.cameras))
    if as_json:
        emit(_document(contents, units) | {"file": str(target)})
        return
    _show_statement(contents, units)
    console.print(f"{len(contents.cameras)} cameras in {target}")


def _sized(file: Path, contents: CameraFile, stated: Sequence[str]) -> tuple[CameraFile, list[Problem]]:
    """Give cameras the stated sizes; report wrong statements, and cameras without a size."""
    problems = []
    sizes_px: dict[str, tuple[int, int]] = {}
    names = {camera.name for camera in contents.cameras}
    for text in stated:
        name, _, sides = text.rpartition("=")
        width, _, height = sides.lower().partition("x")
        if not (width.isdecimal() and height.isdecimal() and SIDE_PX.holds(np.array([width, height], float))):
            message = f"{text!r} is not WIDTHxHEIGHT or CAMERA=WIDTHxHEIGHT, of {SIDE_PX}."
            problems.append(Problem(PARAMETER_UNREADABLE, message, hint="Write it as 1920x1080 or left=1920x1080."))
        elif name and name not in names:
            hint = f"The file has {listed_names(sorted(names))}."
            problems.append(Problem(CAMERA_UNKNOWN, "The file has no camera of this name.", file.name, name, hint=hint))
        else:
            sizes_px[name] = (int(width), int(height))
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


def _show_statement(contents: CameraFile, units: str | None) -> None:
    stated = f"{units}, as stated by --units" if units else "m, as neither the format nor --units states"
    unit = f"{contents.unit}, by the format" if contents.unit else stated
    console.print(f"{contents.format}; lengths in the file: {unit}; axes: {contents.axes}")
    for note in contents.notes:
        warn(note)


def _cells(camera: Camera) -> list[str]:
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


def _document(contents: CameraFile, units: str | None) -> dict[str, Any]:
    return {
        "format": contents.format,
        "units": contents.unit or units or "m",
        "axes": contents.axes,
        "notes": list(contents.notes),
        "cameras": camera_documents(contents.cameras),
    }


app.command("check")(check.command)
