"""Calibrations that commands have made: files, and what the terminal shows of them."""

import json
from pathlib import Path

from api.cli.console import console, emit, print_table, require_writable, warn, writing
from pipeline.calibration.known_points.table import COLUMNS
from pipeline.calibration.report import CalibrationResult, report_document
from pipeline.calibration.write import ENCODERS
from pipeline.core.errors import InputError, Problem
from pipeline.core.problems.sessions import CALIBRATION_FORMAT

POINTS_HELP = f"Points that determine the world: CSV with the columns {', '.join(COLUMNS)}, a line for each view."
"""Help of the option that names a table of known points."""

_REPORT = "report.json"


def require_outputs(out: Path, report: Path | None) -> None:
    """Raise ``InputError`` for an ending that no calibration has, ``PipelineError`` for files that can't be written."""
    if out.suffix.lower() not in ENCODERS:
        message = f"--out must end with one of {', '.join(ENCODERS)}."
        raise InputError([Problem(CALIBRATION_FORMAT, message, file=out.name)])
    require_writable(out, report and report / _REPORT)


def write_made(made: CalibrationResult, out: Path, report: Path | None) -> None:
    """Write a calibration, and its report with its pictures if a folder is given.

    Raises ``PipelineError`` if a file can't be written.
    """
    files = {out: ENCODERS[out.suffix.lower()](made.cameras)}
    if report is not None:
        files[report / _REPORT] = (json.dumps(report_document(made), indent=1) + "\n").encode()
        files |= {report / name: picture.encode() for name, picture in made.pictures.items()}
    for path, content in files.items():
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)


def show_made(made: CalibrationResult, out: Path, as_json: bool) -> None:
    """Show the report of a calibration."""
    document = report_document(made)
    if as_json:
        emit(document | {"file": str(out)})
        return
    print_table(
        ("camera", "views", "reprojection error", "focal length", "sigma", "position sigma"),
        (
            (
                camera["name"],
                str(camera["num_views"]),
                _shown(camera["reprojection_error_px"], "px", 2),
                _shown(camera["focal_px"], "px", 1),
                _shown(camera["focal_sigma_percent"], "%", 2),
                _shown(camera["position_sigma_mm"], "mm", 1),
            )
            for camera in document["cameras"]
        ),
    )
    console.print(f"World: {made.world}")
    for warning in made.warnings:
        warn(str(warning))
    if not made.has_extrinsics:
        warn("The file has intrinsics only. Give it to `multicap calibrate board --intrinsics` to find the poses.")
    console.print(f"{len(made.cameras)} cameras in {out}")


def _shown(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"
