"""`multicap calibration`: show, check and convert calibration files."""

from pathlib import Path
from typing import Annotated, Any

import typer

from api.cli.commands.calibration import check
from api.cli.commands.calibration.cameras import FileArgument, camera_documents, read
from api.cli.console import JsonOption, console, emit, print_table, reporting, warn, writing
from api.cli.options import UnitsOption, UpOption
from pipeline.calibration.contents import UNKNOWN_SIZE, CameraFile
from pipeline.calibration.write import ENCODERS
from pipeline.data.cameras import Camera
from pipeline.errors import InputError, Problem
from pipeline.geometry.camera import center_in_world
from pipeline.problem_codes.sessions import CALIBRATION_FORMAT, INVALID_SIZE

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
    as_json: JsonOption = False,
) -> None:
    """Write a calibration as Multicap's JSON, Caliscope's TOML or OpenCV's YAML, in metres and with Z up."""
    with reporting(as_json):
        contents = read(file, units, up)
        problems = [_unsized(file, camera) for camera in contents.cameras if camera.size_px == UNKNOWN_SIZE]
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


def _unsized(file: Path, camera: Camera) -> Problem:
    message = "The calibration does not contain the size of the picture."
    return Problem(INVALID_SIZE, message, file=file.name, camera=camera.name, field="size")


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
