"""`multicap reconstruct`: videos and a calibration to people in motion, no service needed."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from api.console import StageBars, console, emit, reporting
from pipeline.config import ReconstructionConfig
from pipeline.data import Reconstruction
from pipeline.errors import InputError, PipelineError, Problem
from pipeline.export.results import result_files
from pipeline.metrics.quality import quality_report
from pipeline.run import reconstruct
from pipeline.session import open_session


def write_results(reconstruction: Reconstruction, folder: Path) -> list[Path]:
    """Write all result files into a folder, which is made if it is missing.

    Each is written under a temporary name first, so that a half-written file never bears its name.

    Raises
    ------
    PipelineError
        If the folder can't be written to or the disk is full.
    """
    paths = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in result_files(reconstruction):
            part = folder / f".{name}.part"
            part.write_bytes(content)
            paths.append(part.replace(folder / name))
    except OSError as error:
        raise PipelineError(f"The results can't be written to {folder}: {error.strerror}.") from error
    return paths


def print_summary(metrics: Mapping[str, Any]) -> None:
    """People, frames, reprojection error, coverage, bone length deviation, and what looks wrong."""

    def shown(value: float | None, unit: str, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}f} {unit}"

    table = Table("person", "frames", "reprojection error", "cameras a joint", "coverage", "stature")
    for person in metrics["people"]:
        first, length = person["start_frame"], person["num_frames"]
        table.add_row(
            f"person-{person['id']}",
            f"{first} - {first + length - 1}",
            shown(person["reprojection_error_px"], "px", 1),
            shown(person["views_per_joint"], "", 1),
            shown(100 * person["coverage"], "%", 1),
            shown(person["stature_m"], "m", 2),
        )
    console.print(table)
    console.print(
        f"{metrics['num_frames']} frames at {metrics['frame_rate_hz']:g} Hz; "
        f"median reprojection error {shown(metrics['reprojection_error_px']['median'], 'px', 1)}, "
        f"bone length deviation {shown(metrics['bone_length_std_cm'], 'cm', 1)}"
    )
    for check in metrics["world_checks"]:
        console.print(Text.assemble(("warning ", "yellow"), check["message"]))


def command(
    calibration: Annotated[Path, typer.Option(help="Cameras: Qualisys QCA, Caliscope/anipose TOML or JSON.")],
    out: Annotated[Path, typer.Option(help="Folder for the results; made if it is missing.")],
    videos: Annotated[list[Path], typer.Option(help="A folder with one video a camera, or the videos.")],
    more_videos: Annotated[list[Path] | None, typer.Argument(metavar="[VIDEOS]...", show_default=False)] = None,
    method: Annotated[str, typer.Option(help="How detections become tracks: tracking.")] = "tracking",
    detector: Annotated[str, typer.Option(help="See `multicap models list`.")] = "movenet-multipose",
    chunk_frames: Annotated[
        int, typer.Option(min=1, help="Frames of a camera that are decoded and detected as one piece.")
    ] = 100,
    processes: Annotated[int, typer.Option(min=1, max=64, help="Pieces worked on at once.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Reconstruct everybody in synchronised videos of calibrated cameras."""
    started_s = time.monotonic()
    with reporting(as_json), StageBars(visible=not as_json) as bars:
        if method != "tracking":
            raise InputError([Problem("unknown_method", f"There is no method '{method}'.", hint="Use 'tracking'.")])
        config = ReconstructionConfig(
            method="tracking", detector=detector, chunk_frames=chunk_frames, processes=processes
        )
        named = [*videos, *(more_videos or [])]
        session = open_session(named[0] if len(named) == 1 else named, calibration)
        for warning in session.warnings:
            console.print(Text.assemble(("warning ", "yellow"), warning))
        reconstruction = reconstruct(session, config, bars.update)
        paths = write_results(reconstruction, out)
    metrics = quality_report(reconstruction)
    if as_json:
        emit(
            {
                "tracks": [
                    {"id": track.track_id, "start_frame": track.start_frame, "num_frames": track.num_frames}
                    for track in reconstruction.tracks
                ],
                "metrics": metrics,
                "files": [str(path) for path in paths],
                "timing_s": {**bars.seconds, "total": time.monotonic() - started_s},
                "warnings": list(reconstruction.warnings),
            }
        )
        return
    print_summary(metrics)
    for path in paths:
        console.print(Text(f"  {path}"))
